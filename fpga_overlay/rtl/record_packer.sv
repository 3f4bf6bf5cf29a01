// Two records of 64 bits make a beat; `flush` completes an odd one with zeros.
`default_nettype none

module record_packer (
    input  wire          clk,
    input  wire          rst_n,
    input  wire          record_valid,
    input  wire  [ 63:0] record,
    input  wire          flush,
    output logic         beat_valid,
    output logic [127:0] beat
);
  logic half;

  always_ff @(posedge clk) begin
    if (record_valid && !half) beat[63:0] <= record;
    if (record_valid || flush) beat[127:64] <= record_valid ? record : 64'd0;
    beat_valid <= rst_n && half && (record_valid || flush);
    if (!rst_n || flush) half <= 1'b0;
    else if (record_valid) half <= !half;
  end
endmodule

`default_nettype wire
