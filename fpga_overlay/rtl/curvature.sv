// LOAM's curvature before it is squared, |sum of the ten neighbours' ranges - 10 range|, and its comparison with the
// thresholds. Four clocks from the inputs to the outputs.
`default_nettype none

module curvature (
    input  wire         clk,
    input  wire  [17:0] range,
    input  wire  [21:0] sum,         // of the eleven ranges around, the point's own with them
    input  wire         whole,       // has five neighbours on both sides: else the difference is 0
    input  wire  [21:0] corner,
    input  wire  [21:0] flat,
    output logic [21:0] difference,
    output logic        above,       // the corner threshold
    output logic        below        // the flat threshold
);
  logic [17:0] range_1;
  logic [19:0] triple_1;
  logic [21:0] sum_1;
  logic signed [22:0] signed_2;
  logic [21:0] difference_3;
  logic whole_1, whole_2;
  wire [21:0] magnitude_2 = 22'(signed_2[22] ? -signed_2 : signed_2);

  always_ff @(posedge clk) begin
    whole_1      <= whole;
    range_1      <= range;
    sum_1        <= sum;
    triple_1     <= 20'(range) + {1'b0, range, 1'b0};
    whole_2      <= whole_1;
    signed_2     <= signed'(23'(sum_1) - {2'b00, range_1, 3'b000} - 23'(triple_1));
    difference_3 <= whole_2 ? magnitude_2 : 22'd0;
    difference   <= difference_3;
    above        <= difference_3 > corner;
    below        <= difference_3 < flat;
  end
endmodule

`default_nettype wire
