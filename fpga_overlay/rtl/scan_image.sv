// The image of one scan: takes points while they come, then gives them back ring by ring and is empty again.
//
// Reads and counters belong to the scanner while it works, to the writer else.
`default_nettype none

module scan_image #(
    parameter int RINGS = 128,  // powers of two
    parameter int COLUMNS = 2048,
    parameter int BANK_WORDS = 4096,
    localparam int RING_BITS = $clog2(RINGS),
    localparam int CELL_BITS = RING_BITS + $clog2(COLUMNS)
) (
    input  wire                 clk,
    input  wire                 rst_n,
    input  wire                 point_valid,
    input  wire [CELL_BITS-1:0] point_cell,   // {ring, column}
    input  wire [         35:0] point_data,   // index 35:18, range 17:0, which is not 0
    output wire                 duplicate,    // a point's cell was taken
    output wire                 filling,      // points are still on their way
    input  wire                 start,        // of the scan, when not filling
    input  wire [          7:0] rings,
    input  wire [         11:0] columns,
    input  wire                 room,
    output wire                 scanning,
    output wire                 step,         // see ring_scanner
    output wire                 step_last,
    output wire [          6:0] step_ring,
    output wire [         11:0] step_count,
    output wire [         10:0] step_column,
    output wire [         35:0] step_data
);
  wire [CELL_BITS-1:0] writer_cell, scanner_cell;
  wire [35:0] cell_data, write_data;
  wire [1:0] write;
  wire [CELL_BITS-2:0] write_word, clear_word;
  wire stored, clear, ring_clear;
  wire [RING_BITS-1:0] stored_ring, ring;
  wire [11:0] ring_count;

  cell_writer #(
      .CELL_BITS(CELL_BITS),
      .RING_BITS(RING_BITS)
  ) writer (
      .clk,
      .rst_n,
      .point_valid,
      .point_cell,
      .point_data,
      .read_cell(writer_cell),
      .read_data(cell_data),
      .write,
      .write_word,
      .write_data,
      .stored,
      .stored_ring,
      .duplicate,
      .busy(filling)
  );

  ring_scanner #(
      .RINGS  (RINGS),
      .COLUMNS(COLUMNS)
  ) scanner (
      .clk,
      .rst_n,
      .start,
      .rings,
      .columns,
      .room,
      .busy(scanning),
      .ring,
      .ring_count,
      .ring_clear,
      .read_cell(scanner_cell),
      .read_data(cell_data),
      .clear,
      .clear_word,
      .step,
      .step_last,
      .step_ring,
      .step_count,
      .step_column,
      .step_data
  );

  range_image #(
      .RINGS(RINGS),
      .COLUMNS(COLUMNS),
      .BANK_WORDS(BANK_WORDS)
  ) cells (
      .clk,
      .read_cell(scanning ? scanner_cell : writer_cell),
      .read_data(cell_data),
      .write(write | {2{clear}}),
      .write_word(clear ? clear_word : write_word),
      .write_data(clear ? 36'd0 : write_data)
  );

  ring_counters #(
      .RING_BITS(RING_BITS)
  ) counters (
      .clk,
      .ring (scanning ? ring : stored_ring),
      .add  (stored),
      .clear(ring_clear),
      .count(ring_count)
  );
endmodule

`default_nettype wire
