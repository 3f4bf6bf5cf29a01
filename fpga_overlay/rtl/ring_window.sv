// The window over a ring's points: what lies around point p when point p + 6 (or the p + 6th step) is pushed.
//
// Says of every push: its position in the ring; the point pushed before it; the point six before it (the centre, p)
// and the sum of the eleven ranges around that. All outputs belong to the clock of the push.
`default_nettype none

module ring_window (
    input  wire         clk,
    input  wire         rst_n,
    input  wire         push,
    input  wire         push_last,        // of the ring
    input  wire  [10:0] push_column,
    input  wire  [35:0] push_data,        // index 35:18, range 17:0
    output logic [11:0] position,
    output wire  [17:0] previous_range,
    output wire  [10:0] previous_column,
    output wire  [17:0] centre_range,
    output wire  [10:0] centre_column,
    output wire  [17:0] centre_index,
    output logic [21:0] sum               // of the ranges at p - 5 to p + 5, those before the ring counted as 0
);
  localparam int AHEAD = 6;
  localparam int BEHIND = 5;

  logic [46:0] ahead[1:AHEAD];  // {column, index, range} of the pushes before
  logic [17:0] behind[1:BEHIND];  // ranges of those before that

  wire [17:0] leaves = position > 12'(AHEAD + BEHIND - 1) ? behind[BEHIND] : 18'd0;

  assign previous_range  = ahead[1][17:0];
  assign previous_column = ahead[1][46:36];
  assign centre_range    = ahead[AHEAD][17:0];
  assign centre_index    = ahead[AHEAD][35:18];
  assign centre_column   = ahead[AHEAD][46:36];

  always_ff @(posedge clk) begin
    if (push) begin
      ahead[1]  <= {push_column, push_data};
      behind[1] <= centre_range;
      for (int k = 2; k <= AHEAD; k++) ahead[k] <= ahead[k-1];
      for (int k = 2; k <= BEHIND; k++) behind[k] <= behind[k-1];
    end
    if (!rst_n || (push && push_last)) begin
      position <= 12'd0;
      sum      <= 22'd0;
    end else if (push) begin
      position <= position + 12'd1;
      sum      <= sum + 22'(push_data[17:0]) - 22'(leaves);
    end
  end
endmodule

`default_nettype wire
