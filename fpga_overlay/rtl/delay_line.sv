// A vector, STAGES clocks later. Without reset, so that it maps to shift-register LUTs.
`default_nettype none

module delay_line #(
    parameter int WIDTH  = 1,
    parameter int STAGES = 1  // >= 1
) (
    input  wire              clk,
    input  wire  [WIDTH-1:0] d,
    output wire  [WIDTH-1:0] q
);
  logic [STAGES*WIDTH-1:0] shift;  // the oldest on top

  if (STAGES == 1) begin : g_one
    always_ff @(posedge clk) shift <= d;
  end else begin : g_many
    always_ff @(posedge clk) shift <= {shift[(STAGES-1)*WIDTH-1:0], d};
  end

  assign q = shift[STAGES*WIDTH-1-:WIDTH];
endmodule

`default_nettype wire
