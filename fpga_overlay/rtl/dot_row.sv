// A row of the 3x4 matrix times (x, y, z, 1), rounded and saturated to 24 bits; a point a clock, 6 clocks later.
//
// A coordinate is its low 17 bits + its high 7 bits * 2^17: each product fits a 27x18 multiplier, and the 17 lowest
// bits of the low sum touch the result by their carry alone.
`default_nettype none

module dot_row (
    input  wire                 clk,
    input  wire        [107:0]  row,   // 27-bit entries, 2^-25, entry 3 in 2^-18 m; entry 0 below
    input  wire signed [ 23:0]  x,     // 2^-14 m
    input  wire signed [ 23:0]  y,
    input  wire signed [ 23:0]  z,
    output logic signed [23:0]  moved  // 2^-14 m, saturating at +-(2^23 - 1)
);
  localparam logic signed [23:0] LIMIT = 24'sh7FFFFF;

  wire signed [26:0] mx = row[26:0];
  wire signed [26:0] my = row[53:27];
  wire signed [26:0] mz = row[80:54];

  // 1: products, 2^-39 m and 2^-22 m
  logic signed [43:0] x_low, y_low, z_low;
  logic signed [33:0] x_high, y_high, z_high;
  logic signed [26:0] t;
  // 2, 3: sums of products and translation (2^-18 m = 16 * 2^-22 m)
  logic signed [44:0] xy_low;
  logic signed [43:0] z_low_q;
  logic signed [34:0] xy_high;
  logic signed [34:0] zt_high;
  logic signed [45:0] low;
  logic signed [34:0] high;
  // 4: total, 2^-22 m; 5: rounded to 2^-14 m; 6: saturated
  logic signed [34:0] total;
  logic signed [27:0] rounded;
  wire [4:0] above = rounded[27:23];  // all alike when 24 bits are enough; -2^23 is outside, too
  wire is_inside = (above == '0) || (above == '1 && |rounded[22:0]);

  always_ff @(posedge clk) begin
    x_low  <= mx * $signed({1'b0, x[16:0]});
    y_low  <= my * $signed({1'b0, y[16:0]});
    z_low  <= mz * $signed({1'b0, z[16:0]});
    x_high <= mx * $signed(x[23:17]);
    y_high <= my * $signed(y[23:17]);
    z_high <= mz * $signed(z[23:17]);
    t      <= row[107:81];

    xy_low  <= 45'(x_low) + 45'(y_low);
    z_low_q <= z_low;
    xy_high <= 35'(x_high) + 35'(y_high);
    zt_high <= 35'(z_high) + 35'($signed({t, 4'b0}));

    low  <= 46'(xy_low) + 46'(z_low_q);
    high <= xy_high + zt_high;

    total   <= high + 35'($signed(low[45:17]));
    rounded <= 28'($signed(total[34:8])) + 28'(total[7]);

    if (is_inside) moved <= rounded[23:0];
    else moved <= rounded[27] ? -LIMIT : LIMIT;
  end

  wire unused = &{1'b0, low[16:0], total[6:0]};
endmodule

`default_nettype wire
