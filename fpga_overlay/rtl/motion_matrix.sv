// The 3x4 matrix at a time within a segment: base + slope * dt, rounded, 27 bits; 4 clocks later.
//
// base and slope come from two block-RAM tables that are written row by row. The base is read two clocks after the
// slope, when the product is ready for it.
`default_nettype none

module motion_matrix (
    input  wire          clk,

    input  wire  [  5:0] write,          // base rows 0 to 2, slope rows 0 to 2
    input  wire          write_bank,
    input  wire  [  7:0] write_segment,
    input  wire  [107:0] write_row,      // column 0 below

    input  wire          identity,       // the unit matrix instead
    input  wire          bank,
    input  wire  [  7:0] segment,
    input  wire  [ 16:0] dt,
    output wire  [323:0] matrix          // row-major, entry (0, 0) below: 2^-25, column 3 2^-18 m
);
  wire [8:0] base_address;
  wire [16:0] dt_q;
  wire identity_q;

  delay_line #(
      .WIDTH (9),
      .STAGES(2)
  ) address_delay (
      .clk,
      .d({bank, segment}),
      .q(base_address)
  );
  delay_line #(
      .WIDTH (17),
      .STAGES(2)
  ) dt_delay (
      .clk,
      .d(dt),
      .q(dt_q)
  );
  delay_line #(
      .WIDTH (1),
      .STAGES(3)
  ) identity_delay (
      .clk,
      .d(identity),
      .q(identity_q)
  );

  for (genvar r = 0; r < 3; r++) begin : g_row
    wire [107:0] slopes, bases;

    row_memory slope_memory (
        .clk,
        .write        (write[3+r]),
        .write_address({write_bank, write_segment}),
        .write_row,
        .address      ({bank, segment}),
        .row          (slopes)
    );
    row_memory base_memory (
        .clk,
        .write        (write[r]),
        .write_address({write_bank, write_segment}),
        .write_row,
        .address      (base_address),
        .row          (bases)
    );

    for (genvar c = 0; c < 4; c++) begin : g_entry
      localparam logic [26:0] UNIT = (r == c) ? 27'h2000000 : 27'h0;

      logic signed [26:0] slope;  // 2: from 1, the memory's own register
      logic signed [43:0] product;  // 3
      logic [26:0] entry;  // 4
      wire [46:0] sum = 47'(product) + {bases[c*27+:27], 20'h80000};

      always_ff @(posedge clk) begin
        slope   <= slopes[c*27+:27];
        product <= slope * $signed({1'b0, dt_q});
        entry   <= identity_q ? UNIT : sum[46:20];
      end
      assign matrix[(r*4+c)*27+:27] = entry;
      wire unused = &{1'b0, sum[19:0]};
    end
  end
endmodule

`default_nettype wire
