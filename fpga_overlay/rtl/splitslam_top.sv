// Both cores, one behind the other: packets of points in; deskewed points and the features of their image back.
`default_nettype none

module splitslam_top #(
    parameter int RINGS   = 128,  // storage of the range image, powers of two: 2 to 128
    parameter int COLUMNS = 2048  // 4 to 2048
) (
    input  wire          clk,
    input  wire          rst_n,

    input  wire  [127:0] s_axis_tdata,
    input  wire          s_axis_tvalid,
    output wire          s_axis_tready,
    input  wire          s_axis_tlast,

    output wire  [127:0] m_axis_tdata,
    output wire          m_axis_tvalid,
    input  wire          m_axis_tready,
    output wire          m_axis_tlast
);
  wire [127:0] deskewed_tdata;
  wire deskewed_tvalid, deskewed_tready, deskewed_tlast;

  deskew_core deskew (
      .clk,
      .rst_n,
      .s_axis_tdata,
      .s_axis_tvalid,
      .s_axis_tready,
      .s_axis_tlast,
      .m_axis_tdata (deskewed_tdata),
      .m_axis_tvalid(deskewed_tvalid),
      .m_axis_tready(deskewed_tready),
      .m_axis_tlast (deskewed_tlast)
  );

  feature_core #(
      .RINGS  (RINGS),
      .COLUMNS(COLUMNS)
  ) features (
      .clk,
      .rst_n,
      .s_axis_tdata (deskewed_tdata),
      .s_axis_tvalid(deskewed_tvalid),
      .s_axis_tready(deskewed_tready),
      .s_axis_tlast (deskewed_tlast),
      .m_axis_tdata,
      .m_axis_tvalid,
      .m_axis_tready,
      .m_axis_tlast
  );
endmodule

`default_nettype wire
