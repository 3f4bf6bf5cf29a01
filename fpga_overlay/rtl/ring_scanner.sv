// Reads the range image ring by ring, a cell a clock, empties what it has read, and hands the taken cells on.
//
// After the last column of a ring come FLUSH empty steps, which push the ring's last points through the window. Rings
// without a point are skipped. After reset the whole image and all counters are emptied first.
`default_nettype none

module ring_scanner #(
    parameter int RINGS = 128,
    parameter int COLUMNS = 2048,
    localparam int RING_BITS = $clog2(RINGS),
    localparam int COLUMN_BITS = $clog2(COLUMNS),
    localparam int CELL_BITS = RING_BITS + COLUMN_BITS
) (
    input  wire                  clk,
    input  wire                  rst_n,
    input  wire                  start,
    input  wire  [          7:0] rings,        // 1 to RINGS
    input  wire  [         11:0] columns,      // 1 to COLUMNS
    input  wire                  room,         // a step may be begun; those under way come out all the same
    output wire                  busy,
    output logic [RING_BITS-1:0] ring,
    input  wire  [         11:0] ring_count,
    output wire                  ring_clear,
    output wire  [CELL_BITS-1:0] read_cell,
    input  wire  [         35:0] read_data,    // three clocks later
    output logic                 clear,
    output logic [CELL_BITS-2:0] clear_word,
    output logic                 step,         // a taken cell, or an empty step behind a ring
    output logic                 step_last,    // the last of a ring
    output logic [          6:0] step_ring,
    output logic [         11:0] step_count,   // points of the ring
    output logic [         10:0] step_column,
    output logic [         35:0] step_data     // 0 in an empty step
);
  localparam int LATENCY = 3;
  localparam logic [2:0] FLUSH = 3'd6;

  typedef enum logic [2:0] {
    WIPE,
    IDLE,
    RING,
    READ,
    EMPTY
  } state_t;

  state_t state;
  logic [COLUMN_BITS-1:0] column, last_column;
  logic [RING_BITS-1:0] last_ring;
  logic [11:0] count;
  logic [2:0] flushed;

  wire reads = state == READ && room;
  wire flushes = state == EMPTY && room;
  wire flush_ends = flushed == FLUSH - 3'd1;
  wire row_ends = column == last_column;

  // A step on its way through the image, whose data it meets at the end.
  localparam int WAY_BITS = 3 + 7 + 12 + 11;
  logic [WAY_BITS-1:0] way_1, way_2, way_3;
  logic [LATENCY:1] under_way;
  wire [WAY_BITS-1:0] way_0 = {reads, flushes, flushes && flush_ends, 7'(ring), count, 11'(column)};
  wire read_3, flush_3, last_3;
  wire [ 6:0] ring_3;
  wire [11:0] count_3;
  wire [10:0] column_3;
  assign {read_3, flush_3, last_3, ring_3, count_3, column_3} = way_3;

  assign read_cell = {ring, column};
  assign ring_clear = state == RING || (state == WIPE && row_ends);
  assign busy = state != IDLE || under_way != '0 || step;

  always_ff @(posedge clk) begin
    {way_3, way_2, way_1} <= {way_2, way_1, way_0};
    step_last <= last_3;
    step_ring <= ring_3;
    step_count <= count_3;
    step_column <= column_3;
    step_data <= flush_3 ? 36'd0 : read_data;
    clear_word <= {ring, column[COLUMN_BITS-1:1]};
    if (!rst_n) begin
      under_way <= '0;
      step      <= 1'b0;
      clear     <= 1'b0;
    end else begin
      under_way <= {under_way[LATENCY-1:1], reads || flushes};
      step      <= under_way[LATENCY] && (flush_3 || (read_3 && read_data[17:0] != 18'd0));
      clear     <= state == WIPE || (reads && (column[0] || row_ends));
    end
  end

  always_ff @(posedge clk) begin
    if (!rst_n) begin
      state       <= WIPE;
      ring        <= '0;
      column      <= COLUMN_BITS'(1);
      last_ring   <= RING_BITS'(RINGS - 1);
      last_column <= COLUMN_BITS'(COLUMNS - 1);
    end else begin
      case (state)
        WIPE: begin
          column <= column + COLUMN_BITS'(2);
          if (row_ends) ring <= ring + 1'b1;
          if (row_ends && ring == last_ring) state <= IDLE;
        end
        RING: begin
          count   <= ring_count;
          column  <= '0;
          flushed <= 3'd0;
          if (ring_count != 12'd0) state <= READ;
          else if (ring == last_ring) state <= IDLE;
          else ring <= ring + 1'b1;
        end
        READ:
        if (room) begin
          column <= column + 1'b1;
          if (row_ends) state <= EMPTY;
        end
        EMPTY:
        if (room) begin
          flushed <= flushed + 3'd1;
          if (flush_ends) begin
            ring  <= ring + 1'b1;
            state <= ring == last_ring ? IDLE : RING;
          end
        end
        default: begin
          ring        <= '0;
          last_ring   <= RING_BITS'(rings - 8'd1);
          last_column <= COLUMN_BITS'(columns - 12'd1);
          if (start) state <= RING;
        end
      endcase
    end
  end
endmodule

`default_nettype wire
