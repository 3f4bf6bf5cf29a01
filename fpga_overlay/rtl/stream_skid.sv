// A register slice: every output, `s_ready` too, comes from a register, at full throughput.
`default_nettype none

module stream_skid #(
    parameter int WIDTH = 129
) (
    input  wire              clk,
    input  wire              rst_n,
    input  wire  [WIDTH-1:0] s_data,
    input  wire              s_valid,
    output wire              s_ready,
    output logic [WIDTH-1:0] m_data,
    output logic             m_valid,
    input  wire              m_ready
);
  logic [WIDTH-1:0] spare;
  logic             spare_valid;
  wire              moves = m_ready || !m_valid;

  assign s_ready = !spare_valid;

  always_ff @(posedge clk) begin
    if (moves) m_data <= spare_valid ? spare : s_data;
    if (s_ready) spare <= s_data;
    if (!rst_n) begin
      m_valid     <= 1'b0;
      spare_valid <= 1'b0;
    end else if (moves) begin
      m_valid     <= spare_valid || s_valid;
      spare_valid <= 1'b0;
    end else if (s_valid && s_ready) begin
      spare_valid <= 1'b1;
    end
  end
endmodule

`default_nettype wire
