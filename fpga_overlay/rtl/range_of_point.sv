// Range of a point in 1/1024 m, 18 bits, saturating at 256 m: floor(sqrt((x^2 + y^2 + z^2) / 256)), 23 clocks later.
//
// A square is value * low 17 bits + value * high 7 bits * 2^17: two 27x18 multipliers (golden: fixed.range_of).
`default_nettype none

module range_of_point (
    input  wire                clk,
    input  wire  signed [23:0] x,
    input  wire  signed [23:0] y,
    input  wire  signed [23:0] z,
    output wire         [17:0] range_q
);
  // 1: products
  logic signed [41:0] x_low, y_low, z_low;
  logic signed [30:0] x_high, y_high, z_high;
  // 2, 3: sums of three
  logic signed [42:0] xy_low;
  logic signed [41:0] z_low_q;
  logic signed [31:0] xy_high;
  logic signed [30:0] z_high_q;
  logic signed [43:0] low;
  logic signed [32:0] high;
  // 4: (x^2 + y^2 + z^2) / 256, at most 3 * 2^38; 5: saturated
  logic [40:0] total;
  logic [35:0] radicand;

  always_ff @(posedge clk) begin
    x_low  <= x * $signed({1'b0, x[16:0]});
    y_low  <= y * $signed({1'b0, y[16:0]});
    z_low  <= z * $signed({1'b0, z[16:0]});
    x_high <= x * $signed(x[23:17]);
    y_high <= y * $signed(y[23:17]);
    z_high <= z * $signed(z[23:17]);

    xy_low   <= 43'(x_low) + 43'(y_low);
    z_low_q  <= z_low;
    xy_high  <= 32'(x_high) + 32'(y_high);
    z_high_q <= z_high;

    low  <= 44'(xy_low) + 44'(z_low_q);
    high <= 33'(xy_high) + 33'(z_high_q);

    total    <= 41'($signed(low[43:8])) + {high[31:0], 9'b0};
    radicand <= total[35:0] | {36{|total[40:36]}};
  end

  isqrt #(
      .BITS(18)
  ) square_root (
      .clk,
      .radicand,
      .root(range_q)
  );

  wire unused = &{1'b0, low[7:0], high[32]};
endmodule

`default_nettype wire
