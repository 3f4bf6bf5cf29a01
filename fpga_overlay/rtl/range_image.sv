// The range image: a 36-bit cell (index 35:18, range 17:0; range 0: empty) for every {ring, column}.
//
// A read's data come three clocks after its address: the URAM's own register, one behind the choice among eight banks,
// one behind the choice among the groups of eight. A write is seen by the reads that are asked for in later clocks.
`default_nettype none

module range_image #(
    parameter int RINGS = 128,  // powers of two
    parameter int COLUMNS = 2048,
    parameter int BANK_WORDS = 4096,
    localparam int CELL_BITS = $clog2(RINGS) + $clog2(COLUMNS)
) (
    input  wire                  clk,
    input  wire  [CELL_BITS-1:0] read_cell,
    output logic [         35:0] read_data,
    input  wire  [          1:0] write,       // even, odd cell of the word
    input  wire  [CELL_BITS-2:0] write_word,
    input  wire  [         35:0] write_data
);
  localparam int WORDS = RINGS * COLUMNS / 2;
  localparam int DEPTH = WORDS < BANK_WORDS ? WORDS : BANK_WORDS;
  localparam int BANKS = WORDS / DEPTH;
  localparam int GROUPS = BANKS > 8 ? BANKS / 8 : 1;
  localparam int OF_GROUP = BANKS / GROUPS;
  localparam int DEPTH_BITS = $clog2(DEPTH);
  localparam int CHOICE_BITS = $clog2(OF_GROUP) + 1;
  localparam int GROUP_BITS = GROUPS > 1 ? $clog2(GROUPS) : 1;

  wire [ BANKS*72-1:0] bank_data;
  wire [CELL_BITS-2:0] read_word = read_cell[CELL_BITS-1:1];

  for (genvar b = 0; b < BANKS; b++) begin : banks
    wire reads = (32'(read_word) >> DEPTH_BITS) == b;
    wire writes = (32'(write_word) >> DEPTH_BITS) == b;
    image_bank #(
        .WORDS(DEPTH)
    ) bank (
        .clk,
        .read(reads),
        .read_word(read_word[DEPTH_BITS-1:0]),
        .read_data(bank_data[b*72+:72]),
        .write(write & {2{writes}}),
        .write_word(write_word[DEPTH_BITS-1:0]),
        .write_data
    );
  end

  logic [CHOICE_BITS-1:0] choice;
  logic [GROUP_BITS-1:0] group_1, group_2;
  wire [GROUPS*36-1:0] chosen;
  logic [GROUPS*36-1:0] group_data;
  wire [35:0] data;

  for (genvar g = 0; g < GROUPS; g++) begin : groups
    word_mux #(
        .N(2 * OF_GROUP)
    ) of_banks (
        .words (bank_data[g*OF_GROUP*72+:OF_GROUP*72]),
        .select(choice),
        .word  (chosen[g*36+:36])
    );
  end

  word_mux #(
      .N(GROUPS)
  ) of_groups (
      .words (group_data),
      .select(group_2),
      .word  (data)
  );

  always_ff @(posedge clk) begin
    choice     <= CHOICE_BITS'({32'(read_word) >> DEPTH_BITS, read_cell[0]});
    group_1    <= GROUP_BITS'(32'(read_word) >> (DEPTH_BITS + CHOICE_BITS - 1));
    group_2    <= group_1;
    group_data <= chosen;
    read_data  <= data;
  end
endmodule

`default_nettype wire
