// A row of four 27-bit matrix entries for each of 512 segments (two tables of 256), in block RAM: three 512x36.
`default_nettype none

module row_memory (
    input  wire          clk,
    input  wire          write,
    input  wire  [  8:0] write_address,
    input  wire  [107:0] write_row,
    input  wire  [  8:0] address,
    output logic [107:0] row            // one clock later
);
  (* ram_style = "block" *) logic [107:0] rows[512];

  always_ff @(posedge clk) begin
    if (write) rows[write_address] <= write_row;
    row <= rows[address];
  end
endmodule

`default_nettype wire
