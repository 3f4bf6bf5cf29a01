// float32 metres -> signed 24-bit 2^-14 m, rounded half away from zero. A number a clock, 4 clocks later.
//
// `fits` is low, and q 0, for NaN, infinities and what rounds to 512 m or more (golden: fixed.from_float32).
`default_nettype none

module float_to_fixed (
    input  wire                clk,
    input  wire         [31:0] number,
    output logic signed [23:0] q,
    output logic               fits
);
  // number = +-significand * 2^(exponent - 150); in 2^-14 m: the significand shifted right by 136 - exponent, >= 1.
  localparam logic [7:0] FIRST_TOO_LARGE = 8'd136;

  wire [ 7:0] exponent = number[30:23];
  wire [22:0] fraction = number[22:0];
  wire [ 7:0] right = FIRST_TOO_LARGE - 8'd1 - exponent;  // shift beyond the first place

  // 1: what to shift and how far. Below, bit 0 is the half that rounding looks at. Denormals go far below it.
  logic [23:0] significand;
  logic [4:0] distance;
  logic [2:0] negative;
  logic [2:0] too_large;

  // 2, 3: shifted by multiples of 4, then by the rest.
  logic [23:0] coarse;
  logic [ 1:0] rest;
  logic [23:0] fine;

  // 4: rounded and signed in one addition: -(a + half) = ~a + !half.
  wire [23:0] sum;
  wire unused;
  assign {sum, unused} = {{1'b0, fine[23:1]} ^ {24{negative[2]}}, 1'b1} + {23'b0, 1'b0, negative[2] ^ fine[0]};

  always_ff @(posedge clk) begin
    significand <= {1'b1, fraction};
    distance    <= (right > 8'd24) ? 5'd24 : right[4:0];
    negative    <= {negative[1:0], number[31]};
    too_large   <= {
      too_large[1:0], exponent >= FIRST_TOO_LARGE || (exponent == FIRST_TOO_LARGE - 8'd1 && &fraction)
    };

    coarse <= significand >> {distance[4:2], 2'b00};
    rest   <= distance[1:0];
    fine   <= coarse >> rest;

    q    <= sum;
    fits <= !too_large[2];
    if (too_large[2]) q <= 24'sd0;
  end
endmodule

`default_nettype wire
