// One URAM of the range image: 72-bit words of two cells that are written separately, a read and a write a clock.
`default_nettype none

module image_bank #(
    parameter int WORDS = 4096  // a power of two
) (
    input  wire                     clk,
    input  wire                     read,
    input  wire [$clog2(WORDS)-1:0] read_word,
    output reg  [             71:0] read_data,
    input  wire [              1:0] write,       // lower, upper half
    input  wire [$clog2(WORDS)-1:0] write_word,
    input  wire [             35:0] write_data
);
    (* ram_style = "ultra" *) reg [71:0] words[0:WORDS-1];

    always_ff @(posedge clk) begin
        if (write[0]) words[write_word][35:0] <= write_data;
        if (write[1]) words[write_word][71:36] <= write_data;
    end

    always_ff @(posedge clk) if (read) read_data <= words[read_word];
endmodule

`default_nettype wire
