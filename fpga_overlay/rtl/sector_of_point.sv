// The sector of a ring's point: LIO-SAM cuts the points from the 6th to the 7th last into `sectors` equal parts.
//
// Of L = count - 11 points the k-th lies behind border j when k >= floor(j L / sectors), that is when
// (k + 1) sectors > j L: an accumulator and a comparison a border instead of a division. Two clocks.
`default_nettype none

module sector_of_point (
    input  wire         clk,
    input  wire         push,
    input  wire  [11:0] position,   // of the push, six after the point
    input  wire  [11:0] count,      // points of the ring
    input  wire  [ 3:0] sectors,    // 0 to 7
    output logic        in_sector,
    output logic [ 2:0] sector      // 7: none
);
  localparam logic [2:0] NONE = 3'd7;
  localparam logic [11:0] FIRST = 12'd11;  // position of the push that has the sectors' first point as its centre

  logic [14:0] scaled;  // (k + 1) sectors
  logic [14:0] borders[1:6];
  logic [6:1] beyond;
  logic in_sector_1;
  logic [2:0] behind;
  wire [11:0] length = count - FIRST;

  always_comb begin
    behind = 3'd0;
    for (int j = 1; j <= 6; j++) behind = behind + 3'(beyond[j]);
  end

  always_ff @(posedge clk) begin
    if (push) scaled <= position < FIRST - 12'd1 ? 15'd0 : scaled + 15'(sectors);
    borders[1] <= 15'(length);
    borders[2] <= {2'b00, length, 1'b0};
    borders[3] <= 15'(length) + {2'b00, length, 1'b0};
    borders[4] <= {1'b0, length, 2'b00};
    borders[5] <= 15'(length) + {1'b0, length, 2'b00};
    borders[6] <= {2'b00, length, 1'b0} + {1'b0, length, 2'b00};
    for (int j = 1; j <= 6; j++) beyond[j] <= scaled > borders[j];
    in_sector_1 <= position >= FIRST && position < count && sectors != 4'd0;
    in_sector <= in_sector_1;
    sector <= in_sector_1 ? behind : NONE;
  end
endmodule

`default_nettype wire
