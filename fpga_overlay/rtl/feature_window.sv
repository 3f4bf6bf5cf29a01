// Makes the steps of the ring scanner into records: difference, marks and sector of every point of a ring.
`default_nettype none

module feature_window (
    input  wire         clk,
    input  wire         rst_n,
    input  wire         step,
    input  wire         step_last,
    input  wire  [ 6:0] step_ring,
    input  wire  [11:0] step_count,
    input  wire  [10:0] step_column,
    input  wire  [35:0] step_data,
    input  wire  [17:0] occlusion,
    input  wire  [21:0] corner,
    input  wire  [21:0] flat,
    input  wire  [ 3:0] sector_count,
    output wire         busy,
    output logic        record_valid,
    output logic [63:0] record
);
  localparam int CLOCKS = 5;  // from a step to what is known of its centre

  wire [11:0] position;
  wire [17:0] previous_range, centre_range, centre_index;
  wire [10:0] previous_column, centre_column;
  wire [21:0] sum;

  ring_window window (
      .clk,
      .rst_n,
      .push(step),
      .push_last(step_last),
      .push_column(step_column),
      .push_data(step_data),
      .position,
      .previous_range,
      .previous_column,
      .centre_range,
      .centre_column,
      .centre_index,
      .sum
  );

  // First stage: all that is known at the push.
  logic push_1, near_1, whole_1, counts_1;
  logic [17:0] range_1, previous_1, centre_1;
  logic [21:0] sum_1;

  always_ff @(posedge clk) begin
    push_1     <= rst_n && step;
    near_1     <= step_column - previous_column < 11'd10;
    whole_1    <= position >= 12'd11 && position <= step_count;
    counts_1   <= position >= 12'd6 && position + 12'd6 <= step_count;
    range_1    <= step_data[17:0];
    previous_1 <= previous_range;
    centre_1   <= centre_range;
    sum_1      <= sum;
  end

  wire [21:0] difference;
  wire above, below, masked, in_sector_2;
  wire [2:0] sector_2;

  curvature of_centre (
      .clk,
      .range(centre_1),
      .sum  (sum_1),
      .whole(whole_1),
      .corner,
      .flat,
      .difference,
      .above,
      .below
  );

  reliability marks (
      .clk,
      .rst_n,
      .push(push_1),
      .range(range_1),
      .previous(previous_1),
      .near(near_1),
      .counts(counts_1),
      .occlusion,
      .masked
  );

  sector_of_point of_ring (
      .clk,
      .push(step),
      .position,
      .count(step_count),
      .sectors(sector_count),
      .in_sector(in_sector_2),
      .sector(sector_2)
  );

  // The record waits for what is computed.
  logic [CLOCKS:1] points;
  logic [35:0] names[1:CLOCKS];  // {ring, column, index}
  logic [3:0] parts_3, parts_4, parts_5;
  wire in_sector = parts_5[3];
  wire candidate = in_sector && !masked;

  assign busy = points != '0 || record_valid;

  always_ff @(posedge clk) begin
    points   <= rst_n ? {points[CLOCKS-1:1], step && position >= 12'd6} : '0;
    names[1] <= {step_ring, centre_column, centre_index};
    for (int k = 2; k <= CLOCKS; k++) names[k] <= names[k-1];
    {parts_5, parts_4, parts_3} <= {parts_4, parts_3, in_sector_2, sector_2};
    record_valid <= rst_n && points[CLOCKS];
    record <= {
      candidate && !above && below,
      candidate && above,
      masked,
      parts_5[2:0],
      difference,
      names[CLOCKS][35:29],
      names[CLOCKS][28:18],
      names[CLOCKS][17:0]
    };
  end
endmodule

`default_nettype wire
