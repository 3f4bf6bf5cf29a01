// One level of the binary search for a tick's segment: 2^LEVEL first ticks for each of two tables, one clock.
//
// Level L holds the elements i = (2 k + 1) * 2^(7-L), k = 0 to 2^L - 1: those that a search compares with which knows
// the upper L bits of its answer. Elements beyond the table's last one count as greater than any tick.
`default_nettype none

module search_level #(
    parameter int LEVEL = 0  // 0 to 7
) (
    input  wire         clk,

    input  wire         write,
    input  wire         write_bank,
    input  wire  [ 7:0] write_segment,
    input  wire  [23:0] write_tick,

    input  wire  [ 7:0] last_segment,  // of the table that `bank` names
    input  wire         bank,
    input  wire  [23:0] tick,
    input  wire  [ 7:0] segment,       // found so far: the upper LEVEL bits, the others 0
    input  wire  [16:0] dt,            // since that segment's first tick, saturating

    output logic        next_bank,
    output logic [23:0] next_tick,
    output logic [ 7:0] next_segment,
    output logic [16:0] next_dt
);
  localparam int STEP = 7 - LEVEL;

  (* ram_style = "distributed" *) logic [23:0] first_ticks[2**(LEVEL+1)];  // bank on top

  wire [LEVEL:0] write_address, address;
  if (LEVEL == 0) begin : g_root
    assign write_address = write_bank;
    assign address = bank;
  end else begin : g_level
    assign write_address = {write_bank, write_segment[7-:LEVEL]};
    assign address = {bank, segment[7-:LEVEL]};
  end

  localparam logic [7:0] BIT = 8'd1 << STEP;
  wire mine = (write_segment & ((BIT << 1) - 8'd1)) == BIT;  // the lowest bit that is set

  wire [7:0] element = segment | BIT;
  wire [24:0] since = {1'b0, tick} - {1'b0, first_ticks[address]};
  wire reached = !since[24] && element <= last_segment;

  always_ff @(posedge clk) begin
    if (write && mine) first_ticks[write_address] <= write_tick;

    next_bank    <= bank;
    next_tick    <= tick;
    next_segment <= reached ? element : segment;
    next_dt      <= reached ? since[16:0] | {17{|since[23:17]}} : dt;
  end
endmodule

`default_nettype wire
