// Azimuth of (x, y) in 2^-27 turns, signed; 0 for the origin; 26 clocks later. Vectoring CORDIC on normalised values.
//
// Half-plane: u = |x|, v = y or, behind, -y, so that |angle| <= 90 degrees; a point behind starts from half a turn.
// Normalised so that the larger of u and v uses all bits: the error does not grow towards the origin
// (golden: cordic.azimuth).
`default_nettype none

module cordic_azimuth (
    input  wire                clk,
    input  wire  signed [23:0] x,      // above -2^23
    input  wire  signed [23:0] y,      // above -2^23
    output wire  signed [26:0] angle
);
  localparam int ITERATIONS = 22;
  localparam int PREPARE = 4;  // clocks before the first iteration

  // round(atan(2^-i) / 2 pi * 2^27)
  function automatic logic [26:0] arctangent(input int i);
    case (i)
      0: arctangent = 27'd16777216;
      1: arctangent = 27'd9904169;
      2: arctangent = 27'd5233091;
      3: arctangent = 27'd2656399;
      4: arctangent = 27'd1333354;
      5: arctangent = 27'd667327;
      6: arctangent = 27'd333745;
      7: arctangent = 27'd166883;
      8: arctangent = 27'd83443;
      9: arctangent = 27'd41721;
      10: arctangent = 27'd20861;
      11: arctangent = 27'd10430;
      12: arctangent = 27'd5215;
      13: arctangent = 27'd2608;
      14: arctangent = 27'd1304;
      15: arctangent = 27'd652;
      16: arctangent = 27'd326;
      17: arctangent = 27'd163;
      18: arctangent = 27'd81;
      19: arctangent = 27'd41;
      20: arctangent = 27'd20;
      21: arctangent = 27'd10;
      default: arctangent = 27'd0;
    endcase
  endfunction

  // 1: magnitudes. 2 to 4: shifted up until the larger one's bit 22 is set.
  logic [22:0] u1, v1, u2, v2, u3, v3, u4, v4;
  logic [PREPARE-1:0] behind;
  logic [PREPARE-1:0] left_below;  // sign of v
  wire [22:0] either1 = u1 | v1;
  wire [22:0] u1_far = (either1[22:7] == '0) ? {u1[6:0], 16'b0} : u1;
  wire [22:0] v1_far = (either1[22:7] == '0) ? {v1[6:0], 16'b0} : v1;
  wire [22:0] either1_far = u1_far | v1_far;
  wire [22:0] either2 = u2 | v2;
  wire [22:0] u2_far = (either2[22:19] == '0) ? {u2[18:0], 4'b0} : u2;
  wire [22:0] v2_far = (either2[22:19] == '0) ? {v2[18:0], 4'b0} : v2;
  wire [22:0] either2_far = u2_far | v2_far;
  wire [22:0] either3 = u3 | v3;

  always_ff @(posedge clk) begin
    u1         <= x[23] ? 23'(-x) : x[22:0];
    v1         <= y[23] ? 23'(-y) : y[22:0];
    behind     <= {behind[PREPARE-2:0], x[23]};
    left_below <= {left_below[PREPARE-2:0], x[23] ^ y[23]};
    if (y == '0) left_below[0] <= 1'b0;

    u2 <= (either1_far[22:15] == '0) ? {u1_far[14:0], 8'b0} : u1_far;
    v2 <= (either1_far[22:15] == '0) ? {v1_far[14:0], 8'b0} : v1_far;
    u3 <= (either2_far[22:21] == '0) ? {u2_far[20:0], 2'b0} : u2_far;
    v3 <= (either2_far[22:21] == '0) ? {v2_far[20:0], 2'b0} : v2_far;
    u4 <= either3[22] ? u3 : {u3[21:0], 1'b0};
    v4 <= either3[22] ? v3 : {v3[21:0], 1'b0};
  end

  // Iterations. v is kept as magnitude and sign up to the first one, which makes it signed.
  localparam int U = 27;  // u >= 0 grows by 1.65 * sqrt(2)
  localparam int V = 27;
  wire [(ITERATIONS+1)*U-1:0] us;
  wire [(ITERATIONS+1)*V-1:0] vs;
  wire [(ITERATIONS+1)*27-1:0] angles;
  wire at_origin;

  assign us[0+:U]      = {2'b0, u4, 2'b0};
  assign vs[0+:V]      = {2'b0, v4, 2'b0};
  assign angles[0+:27] = {behind[PREPARE-1], 26'b0};

  for (genvar i = 0; i < ITERATIONS; i++) begin : g_iteration
    // |v| < 2.4 * 2^(26 - i) from the first iteration on: the angle left is below atan(2^(1 - i))
    localparam int W = (i < 2) ? V : V + 1 - i;  // of this iteration's result
    wire [U-1:0] u = us[i*U+:U];
    wire signed [V-1:0] v = vs[i*V+:V];
    wire [U-1:0] du = (i == 0) ? v : v >>> i;
    wire [W-1:0] dv = W'(u >> i);
    wire below = (i == 0) ? left_below[PREPARE-1] : v[V-1];

    // below: u - v/2^i, v + u/2^i, angle - step; above: u + v/2^i, v - u/2^i, angle + step
    wire [U-1:0] u_next;
    wire [W-1:0] v_next;
    wire [2:0] unused_carry;
    if (i == 0) begin : g_first  // u + |v|; |v| - u or u - |v|
      assign {u_next, unused_carry[0]} = {u, 1'b1} + {du, 1'b0};
      assign {v_next, unused_carry[1]} = {v ^ {W{below}}, 1'b1} + {dv ^ {W{!below}}, 1'b1};
    end else begin : g_next
      assign {u_next, unused_carry[0]} = {u, 1'b1} + {du ^ {U{below}}, below};
      assign {v_next, unused_carry[1]} = {v[W-1:0], 1'b1} + {dv ^ {W{!below}}, !below};
    end
    wire [26:0] step = arctangent(i);
    wire [26:0] angle_next;
    assign {angle_next, unused_carry[2]} = {angles[i*27+:27], 1'b1} + {step ^ {27{below}}, below};

    logic [U-1:0] u_q;
    logic [W-1:0] v_q;
    logic [26:0] angle_q;
    always_ff @(posedge clk) begin
      u_q     <= u_next;
      v_q     <= v_next;
      angle_q <= angle_next;
      if (i == ITERATIONS - 1 && at_origin) angle_q <= '0;
    end
    assign us[(i+1)*U+:U] = u_q;
    assign vs[(i+1)*V+:V] = {{(V - W) {v_q[W-1]}}, v_q};
    assign angles[(i+1)*27+:27] = angle_q;
    wire unused = &{1'b0, unused_carry};
  end

  delay_line #(
      .WIDTH (1),
      .STAGES(PREPARE + ITERATIONS - 2)
  ) origin (
      .clk,
      .d(u1 == '0 && v1 == '0),
      .q(at_origin)
  );

  assign angle = angles[ITERATIONS*27+:27];
  wire unused = &{1'b0, either1, either1_far, either2, either2_far, either3, us[ITERATIONS*U+:U], vs[ITERATIONS*V+:V]};
endmodule

`default_nettype wire
