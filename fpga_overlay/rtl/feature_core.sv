// The second core: the range image of a scan, and difference, marks, sector and candidates of its points.
//
// Takes the deskew core's packets (fpga_overlay/golden/packet.py). Header and points pass through and fill the image;
// at the trailer the image is scanned, which empties it, and the records go out ahead of the trailer. Passed on as they
// come: packets with BYPASS_FEATURES, those with an error in their status, and those of fewer than four beats, which
// no sound core sends. BAD_GEOMETRY is added, and no records, when the header asks for no rings or columns, more than
// there is storage for, or more than seven sectors. Valid points outside the header's geometry are left out.
`default_nettype none

module feature_core #(
    parameter int RINGS      = 128,   // storage, powers of two: 2 to 128
    parameter int COLUMNS    = 2048,  // 4 to 2048
    parameter int BANK_WORDS = 4096   // of a URAM; smaller only in tests
) (
    input  wire         clk,
    input  wire         rst_n,
    input  wire [127:0] s_axis_tdata,
    input  wire         s_axis_tvalid,
    output wire         s_axis_tready,
    input  wire         s_axis_tlast,
    output wire [127:0] m_axis_tdata,
    output wire         m_axis_tvalid,
    input  wire         m_axis_tready,
    output wire         m_axis_tlast
);
  localparam int RING_BITS = $clog2(RINGS);
  localparam int COLUMN_BITS = $clog2(COLUMNS);
  localparam int CELL_BITS = RING_BITS + COLUMN_BITS;
  localparam logic [7:0] BAD_GEOMETRY = 8'd8;

  typedef enum logic [2:0] {
    WIPE,       // after reset
    PASS,       // header and points; the last two beats stay: the trailer
    SETTLE,     // the last points reach the image
    SCAN,
    FLUSH,      // an odd record
    TRAILER_0,
    TRAILER_1
  } state_t;

  state_t state;

  // A beat is held until the next one shows what it is.
  wire [127:0] next_data;
  wire next_last, next_valid, next_taken;
  logic [127:0] held;
  logic [1:0] taken;  // beats of the packet, up to 3
  wire room;

  stream_skid #(
      .WIDTH(129)
  ) slice (
      .clk,
      .rst_n,
      .s_data ({s_axis_tlast, s_axis_tdata}),
      .s_valid(s_axis_tvalid),
      .s_ready(s_axis_tready),
      .m_data ({next_last, next_data}),
      .m_valid(next_valid),
      .m_ready(next_taken)
  );

  wire moves = state == PASS && next_valid && room;
  wire ends = moves && next_last;
  wire sound = taken == 2'd3;  // with the last beat, four or more
  wire passes = moves && taken != 2'd0 && !(next_last && sound);

  // The header.
  logic bypassed, fits;
  logic [ 3:0] sector_count;
  logic [ 7:0] rings;
  logic [11:0] columns;
  logic [17:0] occlusion;
  logic [21:0] corner, flat;
  wire active = fits && !bypassed;

  always_ff @(posedge clk) begin
    if (passes && taken == 2'd1) begin
      bypassed     <= held[1];
      sector_count <= held[51:48];
      rings        <= held[71:64];
      columns      <= held[91:80];
    end
    if (passes && taken == 2'd2) begin
      occlusion <= held[17:0];
      corner    <= held[53:32];
      flat      <= held[85:64];
    end
    fits <= rings != 8'd0 && rings <= 8'(RINGS) && columns != 12'd0 && columns <= 12'(COLUMNS) && !sector_count[3];
  end

  // Points go into the image as they pass.
  wire passes_point = passes && sound;
  wire [7:0] held_ring = held[7:0];
  wire [11:0] held_column = {held[67:64], held[39:32]};
  wire [17:0] held_range = held[113:96];
  wire stores = held[68] && held_ring < rings && held_column < columns && held_range != 18'd0;
  logic [17:0] index;
  logic point_valid;
  logic [CELL_BITS-1:0] point_cell;
  logic [35:0] point_data;

  always_ff @(posedge clk) begin
    if (taken == 2'd0) index <= 18'd0;
    else if (passes_point) index <= index + 18'd1;
    point_valid <= rst_n && passes_point && active && stores;
    point_cell  <= {held_ring[RING_BITS-1:0], held_column[COLUMN_BITS-1:0]};
    point_data  <= {index, held_range};
  end

  // Records come out of the image.
  wire duplicate, filling, scanning, step, step_last, record_valid, window_busy, records_valid;
  wire starts = state == SETTLE && !filling;
  wire [6:0] step_ring;
  wire [11:0] step_count;
  wire [10:0] step_column;
  wire [35:0] step_data;
  wire [63:0] record;
  wire [127:0] records_data;

  scan_image #(
      .RINGS(RINGS),
      .COLUMNS(COLUMNS),
      .BANK_WORDS(BANK_WORDS)
  ) image (
      .clk,
      .rst_n,
      .point_valid,
      .point_cell,
      .point_data,
      .duplicate,
      .filling,
      .start(starts),
      .rings,
      .columns,
      .room,
      .scanning,
      .step,
      .step_last,
      .step_ring,
      .step_count,
      .step_column,
      .step_data
  );

  feature_window window (
      .clk,
      .rst_n,
      .step,
      .step_last,
      .step_ring,
      .step_count,
      .step_column,
      .step_data,
      .occlusion,
      .corner,
      .flat,
      .sector_count,
      .busy(window_busy),
      .record_valid,
      .record
  );

  wire quiet = held[7:0] != 8'd0;  // the trailer's status, while it is held

  record_packer packer (
      .clk,
      .rst_n,
      .record_valid(record_valid && !quiet),
      .record,
      .flush(state == FLUSH),
      .beat_valid(records_valid),
      .beat(records_data)
  );

  logic [18:0] records, duplicates;

  always_ff @(posedge clk) begin
    if (taken == 2'd0) begin
      records    <= 19'd0;
      duplicates <= 19'd0;
    end else begin
      if (record_valid && !quiet) records <= records + 19'd1;
      if (duplicate) duplicates <= duplicates + 19'd1;
    end
  end

  // What leaves.
  wire [127:0] trailer_0 = held | (fits || bypassed || quiet ? 128'd0 : 128'(BAD_GEOMETRY));
  wire [127:0] trailer_1 = next_data | (sound && !quiet ? {64'd0, 13'd0, duplicates, 13'd0, records} : 128'd0);
  wire writes_trailer = room && !records_valid && (state == TRAILER_0 || state == TRAILER_1);
  assign next_taken = (moves && !next_last) || (state == TRAILER_1 && writes_trailer);
  logic out_valid, out_last;
  logic [127:0] out_data;

  always_ff @(posedge clk) begin
    out_valid <= rst_n && (passes || writes_trailer || records_valid);
    out_last  <= state == TRAILER_1;
    case (state)
      PASS: out_data <= held;
      TRAILER_0: out_data <= records_valid ? records_data : trailer_0;
      TRAILER_1: out_data <= trailer_1;
      default: out_data <= records_data;
    endcase
  end

  stream_fifo #(
      .WIDTH(129),
      .DEPTH(32),
      .ROOM (16)    // the rest is for the records of the cells under way
  ) answers (
      .clk,
      .rst_n,
      .reserve(out_valid),
      .write(out_valid),
      .write_data({out_last, out_data}),
      .room,
      .m_data({m_axis_tlast, m_axis_tdata}),
      .m_valid(m_axis_tvalid),
      .m_ready(m_axis_tready)
  );

  always_ff @(posedge clk) begin
    if (moves && !next_last) held <= next_data;
    if (!rst_n) begin
      state <= WIPE;
      taken <= 2'd0;
    end else begin
      if (moves && !next_last && !sound) taken <= taken + 2'd1;
      case (state)
        WIPE: if (!scanning) state <= PASS;
        SETTLE: if (starts) state <= SCAN;
        SCAN: if (!scanning && !window_busy && !records_valid) state <= FLUSH;
        FLUSH: state <= TRAILER_0;
        TRAILER_0: if (writes_trailer) state <= TRAILER_1;
        TRAILER_1:
        if (writes_trailer) begin
          state <= PASS;
          taken <= 2'd0;
        end
        default: if (ends) state <= !sound ? TRAILER_1 : active ? SETTLE : TRAILER_0;
      endcase
    end
  end
endmodule

`default_nettype wire
