// Writes points into the range image, one a clock; the first point of a cell wins.
//
// A point's read does not see the writes of the four points before it: it is compared with them. Whether an earlier
// point of the same cell was itself first or not, the cell is taken.
`default_nettype none

module cell_writer #(
    parameter int CELL_BITS = 15,
    parameter int RING_BITS = 4
) (
    input  wire                  clk,
    input  wire                  rst_n,
    input  wire                  point_valid,
    input  wire  [CELL_BITS-1:0] point_cell,
    input  wire  [         35:0] point_data,
    output wire  [CELL_BITS-1:0] read_cell,    // of the range image; its data come three clocks later
    input  wire  [         35:0] read_data,
    output logic [          1:0] write,
    output wire  [CELL_BITS-2:0] write_word,
    output logic [         35:0] write_data,
    output logic                 stored,       // with `write`: a point of ring stored_ring more
    output wire  [RING_BITS-1:0] stored_ring,
    output logic                 duplicate,
    output wire                  busy
);
  localparam int UNSEEN = 4;

  logic [UNSEEN:1] valid;
  logic [CELL_BITS-1:0] cells[1:UNSEEN];
  logic [35:0] data_1, data_2, data_3;
  logic same_1, same_2, same_3;
  wire  taken = same_3 || read_data[17:0] != 18'd0;
  logic same;

  assign read_cell = point_cell;
  assign write_word = cells[UNSEEN][CELL_BITS-1:1];
  assign stored_ring = cells[UNSEEN][CELL_BITS-1-:RING_BITS];
  assign busy = point_valid || valid != '0;

  always_comb begin
    same = 1'b0;
    for (int k = 1; k <= UNSEEN; k++) if (valid[k] && cells[k] == point_cell) same = 1'b1;
  end

  always_ff @(posedge clk) begin
    cells[1] <= point_cell;
    for (int k = 2; k <= UNSEEN; k++) cells[k] <= cells[k-1];
    {data_3, data_2, data_1} <= {data_2, data_1, point_data};
    {same_3, same_2, same_1} <= {same_2, same_1, same};
    write_data <= data_3;
    if (!rst_n) begin
      valid     <= '0;
      write     <= 2'b00;
      stored    <= 1'b0;
      duplicate <= 1'b0;
    end else begin
      valid     <= {valid[UNSEEN-1:1], point_valid};
      write     <= {cells[3][0], !cells[3][0]} & {2{valid[3] && !taken}};
      stored    <= valid[3] && !taken;
      duplicate <= valid[3] && taken;
    end
  end

  wire unused = &{1'b0, read_data[35:18]};
endmodule

`default_nettype wire
