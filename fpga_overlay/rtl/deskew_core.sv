// Deskew core: packets of points in, deskewed points with range, ring and column out, a beat a clock.
//
// Packet formats: fpga_overlay/golden/packet.py; what is computed, bit for bit: fpga_overlay/golden/deskew.py; what bad
// packets are answered: packet_reader.sv. The pipeline never stops: a beat enters only when the output FIFO has a place
// for it. Four lanes run side by side from the fixed-point coordinates (stage 5) to the packer (stage 35):
//
//   stage  1          5            10           14         20         28              35      36
//          reader ─┬─ fixed point ─┬──────────── x, y, z ── moved ───────────────────── packer ─ FIFO
//                  │               ├─ squares, square root ─────────── range ────────────┤
//                  │               └─ CORDIC, multiplier ───────────────────── column ───┤
//                  ├─ search ────────── segment ── matrix ─┘                             │
//                  └─ kind, ring, status ────────────────────────────────────────────────┘
`default_nettype none

module deskew_core (
    input  wire          clk,
    input  wire          rst_n,

    input  wire  [127:0] s_axis_tdata,
    input  wire          s_axis_tvalid,
    output wire          s_axis_tready,
    input  wire          s_axis_tlast,

    output wire  [127:0] m_axis_tdata,
    output wire          m_axis_tvalid,
    input  wire          m_axis_tready,
    output wire          m_axis_tlast
);
  // Stages at which lanes end.
  localparam int READ = 1;
  localparam int FIXED = READ + 4;
  localparam int SEARCHED = READ + 9;
  localparam int MATRIX = SEARCHED + 4;
  localparam int MOVED = MATRIX + 6;
  localparam int RANGE = FIXED + 23;
  localparam int AZIMUTH = FIXED + 26;
  localparam int COLUMN = AZIMUTH + 4;
  localparam int PACK = COLUMN;

  wire room, push;
  wire out_valid, identity, bank, table_bank;
  wire [1:0] kind;
  wire [127:0] beat;
  wire [7:0] status, rings, table_segment, last_segment0, last_segment1;
  wire [11:0] columns;
  wire [6:0] table_write;

  packet_reader reader (
      .clk,
      .rst_n,
      .s_axis_tdata,
      .s_axis_tvalid,
      .s_axis_tready,
      .s_axis_tlast,
      .room,
      .push,
      .out_valid,
      .out_kind(kind),
      .out_beat(beat),
      .status,
      .identity,
      .bank,
      .rings,
      .columns,
      .table_write,
      .table_bank,
      .table_segment,
      .last_segment0,
      .last_segment1
  );

  wire [7:0] ring = beat[127:120];

  // Coordinates in fixed point.
  wire [2:0] fits;
  wire [71:0] fixed;
  for (genvar c = 0; c < 3; c++) begin : g_coordinate
    float_to_fixed convert (
        .clk,
        .number(beat[c*32+:32]),
        .q(fixed[c*24+:24]),
        .fits(fits[c])
    );
  end

  // The matrix of the point's time, and the point where the LiDAR was at the scan's start.
  wire found_bank, found_identity;
  wire [7:0] found_segment;
  wire [16:0] found_dt;
  segment_search search (
      .clk,
      .write        (table_write[0]),
      .write_bank   (table_bank),
      .write_segment(table_segment),
      .write_tick   (beat[23:0]),
      .last_segment0,
      .last_segment1,
      .bank,
      .tick         (beat[119:96]),
      .found_bank,
      .found_segment,
      .found_dt
  );
  delay_line #(
      .WIDTH (1),
      .STAGES(SEARCHED - READ)
  ) identity_delay (
      .clk,
      .d(identity),
      .q(found_identity)
  );

  wire [323:0] matrix;
  motion_matrix motion (
      .clk,
      .write        (table_write[6:1]),
      .write_bank   (table_bank),
      .write_segment(table_segment),
      .write_row    ({beat[122:96], beat[90:64], beat[58:32], beat[26:0]}),
      .identity     (found_identity),
      .bank         (found_bank),
      .segment      (found_segment),
      .dt           (found_dt),
      .matrix
  );

  wire [71:0] point, moved, packed_moved;
  delay_line #(
      .WIDTH (72),
      .STAGES(MATRIX - FIXED)
  ) point_delay (
      .clk,
      .d(fixed),
      .q(point)
  );
  for (genvar r = 0; r < 3; r++) begin : g_row
    dot_row dot (
        .clk,
        .row(matrix[r*108+:108]),
        .x(point[23:0]),
        .y(point[47:24]),
        .z(point[71:48]),
        .moved(moved[r*24+:24])
    );
  end
  delay_line #(
      .WIDTH (72),
      .STAGES(PACK - MOVED)
  ) moved_delay (
      .clk,
      .d(moved),
      .q(packed_moved)
  );

  // Range and column of the point as measured.
  wire [17:0] range_q, packed_range;
  range_of_point range_lane (
      .clk,
      .x(fixed[23:0]),
      .y(fixed[47:24]),
      .z(fixed[71:48]),
      .range_q
  );
  delay_line #(
      .WIDTH (18),
      .STAGES(PACK - RANGE)
  ) range_delay (
      .clk,
      .d(range_q),
      .q(packed_range)
  );

  wire [26:0] angle;
  wire [11:0] angle_columns, column;
  cordic_azimuth azimuth (
      .clk,
      .x(fixed[23:0]),
      .y(fixed[47:24]),
      .angle
  );
  delay_line #(
      .WIDTH (12),
      .STAGES(AZIMUTH - READ)
  ) columns_delay (
      .clk,
      .d(columns),
      .q(angle_columns)
  );
  column_of_azimuth column_lane (
      .clk,
      .angle,
      .columns(angle_columns),
      .column
  );

  // What goes along: the kind of beat, the ring and whether the image has it, or a trailer's status.
  wire packed_fits;
  delay_line #(
      .WIDTH (1),
      .STAGES(PACK - FIXED)
  ) fits_delay (
      .clk,
      .d(&fits),
      .q(packed_fits)
  );
  wire [1:0] packed_kind;
  wire [7:0] packed_ring;
  wire packed_inside;
  delay_line #(
      .WIDTH (11),
      .STAGES(PACK - READ)
  ) along_delay (
      .clk,
      .d({kind, ring < rings, kind[1] ? status : ring}),
      .q({packed_kind, packed_inside, packed_ring})
  );
  logic [PACK:READ] valid;  // by stage; a reset empties the pipeline
  always_comb valid[READ] = out_valid;
  always_ff @(posedge clk) begin
    valid[PACK:READ+1] <= valid[PACK-1:READ];
    if (!rst_n) valid[PACK:READ+1] <= '0;
  end

  wire write;
  wire [128:0] write_data;
  packer pack (
      .clk,
      .rst_n,
      .header_valid(out_valid && kind == 2'd0),
      .header(beat),
      .valid(valid[PACK]),
      .kind(packed_kind),
      .moved(packed_moved),
      .range_q(packed_range),
      .column,
      .ring(packed_ring),
      .in_image(packed_inside),
      .fits(packed_fits),
      .write,
      .write_data
  );

  stream_fifo #(
      .WIDTH(129),
      .DEPTH(64)
  ) fifo (
      .clk,
      .rst_n,
      .room,
      .reserve(push),
      .write,
      .write_data,
      .m_valid(m_axis_tvalid),
      .m_ready(m_axis_tready),
      .m_data ({m_axis_tlast, m_axis_tdata})
  );

  wire unused = &{1'b0, beat[31:27], beat[63:59], beat[95:91]};
endmodule

`default_nettype wire
