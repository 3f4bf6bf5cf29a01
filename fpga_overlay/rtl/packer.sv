// Puts the beats of the answer together where the lanes meet: header echo, points, and the trailer that counts them.
//
// Headers do not travel down the pipeline: they wait here, in a FIFO that holds all that can be under way.
`default_nettype none

module packer (
    input  wire          clk,
    input  wire          rst_n,

    input  wire          header_valid,  // a header beat enters the pipeline
    input  wire  [127:0] header,

    input  wire          valid,         // a beat leaves the pipeline; all below is of that beat
    input  wire  [  1:0] kind,
    input  wire  [ 71:0] moved,         // x, y, z, 24 bits each, x below
    input  wire  [ 17:0] range_q,
    input  wire  [ 11:0] column,
    input  wire  [  7:0] ring,          // or the status, of TRAILER_0
    input  wire          in_image,      // the ring is one of the image's
    input  wire          fits,          // the coordinates are numbers in range

    output logic         write,
    output logic [128:0] write_data     // tlast on top
);
  localparam logic [1:0] ECHO = 2'd0;
  localparam logic [1:0] POINT = 2'd1;
  localparam logic [1:0] TRAILER_0 = 2'd2;
  localparam logic [1:0] TRAILER_1 = 2'd3;
  localparam logic [23:0] MAGIC_VERSION = 24'h534C01;

  // The pipeline has 35 stages, and of 4 beats one after the other at most 2 are headers.
  (* ram_style = "distributed" *) logic [127:0] headers[32];
  logic [4:0] came, gone;
  wire [127:0] echo = headers[gone];

  wire is_echo = kind == ECHO;
  wire is_point = kind == POINT;
  wire usable = fits && range_q != '0;
  wire good = usable && in_image;
  wire [3:0] flags = {1'b0, !in_image, !usable, good};

  logic [31:0] points, invalid;  // of this packet so far
  logic [31:0] sequence_number;
  logic second_header;

  wire show = is_point && good;
  wire [23:0] x = moved[23:0] & {24{show}};
  wire [23:0] y = moved[47:24] & {24{show}};
  wire [23:0] z = moved[71:48] & {24{show}};
  wire [11:0] shown_column = column & {12{show}};
  wire [127:0] point = {
    14'b0, range_q & {18{show}}, z, flags, shown_column[11:8], y, shown_column[7:0], x, ring
  };
  wire [127:0] trailer = {sequence_number, invalid, points, MAGIC_VERSION, ring};

  always_ff @(posedge clk) begin
    if (header_valid) headers[came] <= header;

    write_data[127:0] <= (is_point ? point : '0) | (is_echo ? echo : '0) | (kind == TRAILER_0 ? trailer : '0);
    write_data[128]   <= kind == TRAILER_1;
    write             <= valid;

    came <= came + 5'(header_valid);
    gone <= gone + 5'(valid && is_echo);
    if (valid && is_echo) begin
      second_header <= !second_header;
      if (!second_header) sequence_number <= echo[127:96];
      points  <= '0;
      invalid <= '0;
    end
    if (valid && is_point) begin
      points  <= points + 32'd1;
      invalid <= invalid + 32'(!good);
    end

    if (!rst_n) begin
      write         <= 1'b0;
      came          <= '0;
      gone          <= '0;
      second_header <= 1'b0;
    end
  end
endmodule

`default_nettype wire
