`default_nettype none

// One register stage that answers every packet with itself, for the tests of the harness. Two beats make it sin:
// one of all ones is swallowed, and one of all ones but for bit 0 is changed while it waits.
module loopback #(
    parameter int RINGS   = 16,
    parameter int COLUMNS = 1024
) (
    input  wire          clk,
    input  wire          rst_n,
    input  wire  [127:0] s_axis_tdata,
    input  wire          s_axis_tvalid,
    output wire          s_axis_tready,
    input  wire          s_axis_tlast,
    output logic [127:0] m_axis_tdata,
    output logic         m_axis_tvalid,
    input  wire          m_axis_tready,
    output logic         m_axis_tlast
);

  assign s_axis_tready = rst_n && (!m_axis_tvalid || m_axis_tready);

  always_ff @(posedge clk) begin
    if (s_axis_tready) begin
      m_axis_tdata  <= s_axis_tdata;
      m_axis_tlast  <= s_axis_tlast;
      m_axis_tvalid <= s_axis_tvalid && s_axis_tdata != '1;
    end else if (m_axis_tdata == ~128'd1) begin
      m_axis_tdata <= m_axis_tdata + 128'd1;
    end
    if (!rst_n) m_axis_tvalid <= 1'b0;
  end

  wire unused = &{1'b0, RINGS[0], COLUMNS[0]};

endmodule

`default_nettype wire
