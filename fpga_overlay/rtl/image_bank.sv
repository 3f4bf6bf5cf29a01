// One URAM of the range image: 72-bit words of two cells that are written separately, a read and a write a clock.
`default_nettype none

module image_bank #(
    parameter int WORDS = 4096  // a power of two
) (
    input  wire                      clk,
    input  wire                      read,
    input  wire  [$clog2(WORDS)-1:0] read_word,
    output logic [             71:0] read_data,
    input  wire  [              1:0] write,       // lower, upper half
    input  wire  [$clog2(WORDS)-1:0] write_word,
    input  wire  [             35:0] write_data
);
  (* ram_style = "ultra" *) logic [71:0] words[0:WORDS-1];

  always_ff @(posedge clk) begin
    // Byte by byte, 9 bits each: the form in which URAM with byte enables is inferred.
    for (int k = 0; k < 8; k++) if (write[k/4]) words[write_word][k*9+:9] <= write_data[(k%4)*9+:9];
  end

  always_ff @(posedge clk) if (read) read_data <= words[read_word];
endmodule

`default_nettype wire
