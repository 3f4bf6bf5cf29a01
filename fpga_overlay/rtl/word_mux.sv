// One of N words, by a binary tree.
`default_nettype none

module word_mux #(
    parameter int N = 2,  // a power of two
    parameter int WIDTH = 36
) (
    input  wire [            N*WIDTH-1:0] words,
    input  wire [(N>1?$clog2(N) : 1)-1:0] select,
    output wire [              WIDTH-1:0] word
);
  logic [N*WIDTH-1:0] tree;

  always_comb begin
    tree = words;
    for (int level = 0; level < $clog2(N); level++)
    for (int k = 0; k < (N >> (level + 1)); k++)
    tree[k*WIDTH+:WIDTH] = select[level] ? tree[(2*k+1)*WIDTH+:WIDTH] : tree[2*k*WIDTH+:WIDTH];
  end

  assign word = tree[WIDTH-1:0];

  wire unused = &{1'b0, tree, select};
endmodule

`default_nettype wire
