// floor(sqrt(radicand)), a number a clock, BITS clocks later: one bit of the root a stage, non-restoring.
//
// Invariant after k stages: root = the k upper bits of the result, remainder = what is left of the radicand's 2k upper
// bits after root^2, or that minus (2 root + 1) when the last bit is 0: then negative and made good by the next stage.
`default_nettype none

module isqrt #(
    parameter int BITS = 18  // of the root
) (
    input  wire               clk,
    input  wire  [2*BITS-1:0] radicand,
    output wire  [  BITS-1:0] root
);
  localparam int R = BITS + 2;  // remainder, signed

  // The last remainder and the bits used up on the way are not used.
  // verilator lint_off UNUSEDSIGNAL
  wire [(BITS+1)*2*BITS-1:0] rests;
  wire [(BITS+1)*BITS-1:0] roots;
  wire [(BITS+1)*R-1:0] remainders;
  // verilator lint_on UNUSEDSIGNAL

  assign rests[2*BITS-1:0]   = radicand;
  assign roots[BITS-1:0]     = '0;
  assign remainders[R-1:0]   = '0;

  for (genvar k = 0; k < BITS; k++) begin : g_stage
    localparam int W = k + 3;  // of this stage's remainder: |remainder| <= 2 root + 1

    wire [2*BITS-1:0] rest = rests[k*2*BITS+:2*BITS];
    wire [BITS-1:0] so_far = roots[k*BITS+:BITS];
    wire [R-1:0] remainder = remainders[k*R+:R];
    wire below = remainder[R-1];

    // 4 r + next two bits, minus (4 root + 1), or plus (4 root + 3) after a negative remainder
    wire [W-1:0] minuend = {remainder[W-3:0], rest[2*BITS-1-:2]};
    wire [W-1:0] term = {so_far[W-3:0], below, 1'b1};
    wire [W-1:0] next;
    wire carry;
    assign {next, carry} = {minuend, 1'b1} + {term ^ {W{!below}}, !below};

    logic [2*BITS-1:0] rest_q;
    logic [BITS-1:0] root_q;
    logic [W-1:0] remainder_q;
    always_ff @(posedge clk) begin
      rest_q      <= rest << 2;
      root_q      <= {so_far[BITS-2:0], !next[W-1]};
      remainder_q <= next;
    end
    assign rests[(k+1)*2*BITS+:2*BITS] = rest_q;
    assign roots[(k+1)*BITS+:BITS]     = root_q;
    if (W >= R) begin : g_whole
      assign remainders[(k+1)*R+:R] = remainder_q[R-1:0];
    end else begin : g_narrow
      assign remainders[(k+1)*R+:R] = {{(R - W) {remainder_q[W-1]}}, remainder_q};
    end
    wire unused = &{1'b0, carry, so_far[BITS-1]};
  end

  assign root = roots[BITS*BITS+:BITS];
endmodule

`default_nettype wire
