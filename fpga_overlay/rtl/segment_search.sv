// The segment of a tick (the last one that begins at or before it, or the first one) and the ticks since its beginning,
// saturating at 0 and 2^17 - 1. A tick a clock, 9 clocks later. Two tables: one is written while the other is searched.
`default_nettype none

module segment_search (
    input  wire        clk,

    input  wire        write,
    input  wire        write_bank,
    input  wire [ 7:0] write_segment,
    input  wire [23:0] write_tick,     // the segment's first

    input  wire [ 7:0] last_segment0,  // of the table in bank 0, 1
    input  wire [ 7:0] last_segment1,
    input  wire        bank,
    input  wire [23:0] tick,

    output wire        found_bank,
    output wire [ 7:0] found_segment,
    output wire [16:0] found_dt
);
  localparam int LEVELS = 8;

  // Element 0 is on no level: it is the answer of whom no other one is.
  logic [23:0] first_tick0, first_tick1;
  wire [24:0] since = {1'b0, tick} - {1'b0, bank ? first_tick1 : first_tick0};

  logic start_bank;
  logic [23:0] start_tick;
  logic [16:0] start_dt;
  always_ff @(posedge clk) begin
    if (write && write_segment == '0 && !write_bank) first_tick0 <= write_tick;
    if (write && write_segment == '0 && write_bank) first_tick1 <= write_tick;

    start_bank <= bank;
    start_tick <= tick;
    start_dt   <= since[16:0] | {17{|since[23:17]}};
    if (since[24]) start_dt <= '0;
  end

  wire [LEVELS:0] banks;
  wire [(LEVELS+1)*24-1:0] ticks;
  wire [(LEVELS+1)*8-1:0] segments;
  wire [(LEVELS+1)*17-1:0] dts;
  assign banks[0]      = start_bank;
  assign ticks[0+:24]  = start_tick;
  assign segments[7:0] = '0;
  assign dts[0+:17]    = start_dt;

  for (genvar level = 0; level < LEVELS; level++) begin : g_level
    search_level #(
        .LEVEL(level)
    ) search (
        .clk,
        .write,
        .write_bank,
        .write_segment,
        .write_tick,
        .last_segment(banks[level] ? last_segment1 : last_segment0),
        .bank        (banks[level]),
        .tick        (ticks[level*24+:24]),
        .segment     (segments[level*8+:8]),
        .dt          (dts[level*17+:17]),
        .next_bank   (banks[level+1]),
        .next_tick   (ticks[(level+1)*24+:24]),
        .next_segment(segments[(level+1)*8+:8]),
        .next_dt     (dts[(level+1)*17+:17])
    );
  end

  assign found_bank    = banks[LEVELS];
  assign found_segment = segments[LEVELS*8+:8];
  assign found_dt      = dts[LEVELS*17+:17];
  wire unused = &{1'b0, ticks[LEVELS*24+:24]};
endmodule

`default_nettype wire
