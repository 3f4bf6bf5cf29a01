// Reads packets beat by beat: what goes down the pipeline (header echo, points, trailer), what goes into the tables.
//
// Everything that leaves is registered: a beat comes out one clock after it was taken. Status of a packet, in its
// trailer; a packet with any loses its points:
//   TRUNCATED (1): TLAST in the header, or in the table of a sound header.
//   TOO_MANY_SEGMENTS (2): more than 256. BAD_HEADER (4): magic or version. The rest of the packet is not looked at.
// The bank changes once a table is complete, never for one cut short: so the table before it, whose points may still be
// on the way, is not written until a whole packet (table, trailer, next header: 16 clocks at the least) lies between.
`default_nettype none

module packet_reader (
    input  wire          clk,
    input  wire          rst_n,

    input  wire  [127:0] s_axis_tdata,
    input  wire          s_axis_tvalid,
    output logic         s_axis_tready,
    input  wire          s_axis_tlast,

    input  wire          room,           // for one more beat in the pipeline
    output logic         push,           // a beat enters the pipeline: used now, `out_valid` is the same a clock later

    output logic         out_valid,
    output logic [  1:0] out_kind,       // ECHO, POINT, TRAILER_0, TRAILER_1
    output logic [127:0] out_beat,       // of ECHO and POINT, and what the table is written from
    output logic [  7:0] status,         // of the packet that out_beat belongs to, as is all below
    output logic         identity,       // no table, or deskew bypassed
    output logic         bank,           // table of the packet's points
    output logic [  7:0] rings,
    output logic [ 11:0] columns,

    output logic [  6:0] table_write,    // which beat of a segment out_beat is, one-hot
    output logic         table_bank,
    output logic [  7:0] table_segment,
    output logic [  7:0] last_segment0,  // of the table in bank 0, 1
    output logic [  7:0] last_segment1
);
  localparam logic [15:0] MAGIC = 16'h534C;
  localparam logic [7:0] VERSION = 8'd1;
  localparam logic [15:0] MAX_SEGMENTS = 16'd256;
  localparam logic [7:0] TRUNCATED = 8'd1;
  localparam logic [7:0] TOO_MANY_SEGMENTS = 8'd2;
  localparam logic [7:0] BAD_HEADER = 8'd4;

  localparam logic [1:0] ECHO = 2'd0;
  localparam logic [1:0] POINT = 2'd1;
  localparam logic [1:0] TRAILER_0 = 2'd2;
  localparam logic [1:0] TRAILER_1 = 2'd3;

  typedef enum logic [2:0] {
    READ_HEADER_0,
    READ_HEADER_1,
    READ_TABLE,
    READ_POINTS,
    READ_REST,       // of a packet that was refused
    SEND_ZEROS,      // instead of the second header beat, which did not come
    SEND_TRAILER_0,
    SEND_TRAILER_1
  } state_t;
  state_t state;

  logic [7:0] segment;  // being read
  logic [7:0] last_segment;  // of the table being read
  logic [6:0] row;  // of the segment, one-hot
  logic has_table;
  logic next_bank;  // for the table being read

  // Fields of header beat 0.
  wire bypass = s_axis_tdata[0];
  wire [15:0] segments = s_axis_tdata[47:32];
  wire bad_header = s_axis_tdata[31:16] != MAGIC || s_axis_tdata[15:8] != VERSION;
  wire too_many = !bad_header && segments > MAX_SEGMENTS;

  wire table_state = state == READ_TABLE || state == READ_REST;
  wire pipe_state = state == READ_HEADER_0 || state == READ_HEADER_1 || state == READ_POINTS;
  assign s_axis_tready = table_state || (pipe_state && room);
  wire accept = s_axis_tvalid && s_axis_tready;
  wire table_end = row[6] && segment == last_segment;
  assign push = room && (pipe_state ? s_axis_tvalid : !table_state);

  always_ff @(posedge clk) begin
    out_beat <= s_axis_tdata;
    if (state == SEND_ZEROS) out_beat <= '0;
    case (state)
      READ_POINTS: out_kind <= POINT;
      SEND_TRAILER_0: out_kind <= TRAILER_0;
      SEND_TRAILER_1: out_kind <= TRAILER_1;
      default: out_kind <= ECHO;
    endcase
    table_bank    <= next_bank;
    table_segment <= segment;
    table_write   <= (accept && state == READ_TABLE) ? row : '0;
    out_valid     <= push;

    case (state)
      READ_HEADER_0:
      if (accept) begin
        status       <= (bad_header ? BAD_HEADER : 8'd0) | (too_many ? TOO_MANY_SEGMENTS : 8'd0)
                      | (s_axis_tlast ? TRUNCATED : 8'd0);
        has_table    <= segments != '0;
        identity     <= bypass || segments == '0;
        last_segment <= segments[7:0] - 8'd1;
        rings        <= s_axis_tdata[71:64];
        columns      <= s_axis_tdata[91:80];
        segment      <= '0;
        row          <= 7'd1;
        state        <= s_axis_tlast ? SEND_ZEROS : READ_HEADER_1;
      end

      READ_HEADER_1:
      if (accept) begin
        if (s_axis_tlast) state <= SEND_TRAILER_0;
        else if (status != '0) state <= READ_REST;
        else state <= has_table ? READ_TABLE : READ_POINTS;
        if (s_axis_tlast && status == '0 && has_table) status <= TRUNCATED;
      end

      READ_TABLE:
      if (accept) begin
        row <= {row[5:0], row[6]};
        if (row[6]) segment <= segment + 8'd1;
        if (table_end) begin
          state     <= s_axis_tlast ? SEND_TRAILER_0 : READ_POINTS;
          bank      <= next_bank;
          next_bank <= !next_bank;
          if (next_bank) last_segment1 <= last_segment;
          else last_segment0 <= last_segment;
        end else if (s_axis_tlast) begin
          state  <= SEND_TRAILER_0;
          status <= TRUNCATED;
        end
      end

      READ_POINTS, READ_REST: if (accept && s_axis_tlast) state <= SEND_TRAILER_0;
      SEND_ZEROS: if (room) state <= SEND_TRAILER_0;
      SEND_TRAILER_0: if (room) state <= SEND_TRAILER_1;
      SEND_TRAILER_1: if (room) state <= READ_HEADER_0;
      default: state <= READ_HEADER_0;
    endcase

    if (!rst_n) begin
      state       <= READ_HEADER_0;
      out_valid   <= 1'b0;
      table_write <= '0;
      bank        <= 1'b0;
      next_bank   <= 1'b0;
    end
  end
endmodule

`default_nettype wire
