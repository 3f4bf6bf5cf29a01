// How many cells of each ring are taken, in LUT RAM.
`default_nettype none

module ring_counters #(
    parameter int RING_BITS = 4
) (
    input  wire                 clk,
    input  wire [RING_BITS-1:0] ring,
    input  wire                 add,
    input  wire                 clear,
    output wire [         11:0] count
);
  (* ram_style = "distributed" *) logic [11:0] counts[0:(1<<RING_BITS)-1];

  assign count = counts[ring];

  always_ff @(posedge clk) if (add || clear) counts[ring] <= clear ? 12'd0 : count + 12'd1;
endmodule

`default_nettype wire
