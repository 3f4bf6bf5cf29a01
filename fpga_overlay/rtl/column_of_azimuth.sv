// Column of the range image: LIO-SAM's, counter-clockwise, +x in the middle, halves rounded away from zero.
// A column a clock, 4 clocks later. Of odd widths the golden model knows a column -1; this does not.
`default_nettype none

module column_of_azimuth (
    input  wire                clk,
    input  wire  signed [26:0] angle,    // 2^-27 turns
    input  wire         [11:0] columns,  // of the image, even
    output logic        [11:0] column
);
  // 1: angle * columns, 2^-27 columns
  logic signed [39:0] product;
  logic [11:0] columns1, columns2, columns3;
  // 2: whole columns before rounding, and whether to round up: from a half on, or from above a half when negative
  logic [11:0] whole;
  logic up;
  // 3: rounded, 0 to columns
  logic [11:0] rounded;

  always_ff @(posedge clk) begin
    product  <= angle * $signed({1'b0, columns});
    columns1 <= columns;

    whole    <= {1'b0, columns1[11:1]} + product[38:27];
    up       <= product[26] && (!product[39] || |product[25:0]);
    columns2 <= columns1;

    rounded  <= whole + 12'(up);
    columns3 <= columns2;

    column   <= rounded;
    if (rounded == columns3) column <= '0;
  end
  wire unused = &{1'b0, product[39]};
endmodule

`default_nettype wire
