// Marks points that may be occluded from elsewhere and beams nearly parallel to the surface, as LIO-SAM does.
//
// What is seen at a push concerns the point i before it and its two neighbours: i and five before it are masked when
// it lies behind its successor, the six after it when the successor lies behind it, i itself when both neighbours'
// ranges differ by more than 2 %. The answer is about the point six before the push, four clocks after the push.
`default_nettype none

module reliability (
    input  wire         clk,
    input  wire         rst_n,
    input  wire         push,
    input  wire  [17:0] range,
    input  wire  [17:0] previous,   // range of i
    input  wire         near,       // less than 10 columns lie between the two
    input  wire         counts,     // i is none of the ring's first five or last six points
    input  wire  [17:0] occlusion,
    output logic        masked
);
  localparam int BEFORE = 5;  // points masked on the near side beside i
  localparam int AFTER = 6;

  logic [3:1] pushed, counting;
  logic [2:1] close;
  logic signed [18:0] step_1;
  logic [17:0] range_1, range_2, range_3, previous_1, previous_2, previous_3;
  logic [17:0] magnitude_2;
  logic away_2, behind_3, before_3;
  logic [23:0] fiftyfold_3;

  always_ff @(posedge clk) begin
    pushed <= rst_n ? {pushed[2:1], push} : 3'b000;
    counting <= {counting[2:1], counts};
    close <= {close[1], near};
    {range_3, range_2, range_1} <= {range_2, range_1, range};
    {previous_3, previous_2, previous_1} <= {previous_2, previous_1, previous};
    step_1 <= signed'({1'b0, range} - {1'b0, previous});
    away_2 <= !step_1[18];  // the successor is farther
    magnitude_2 <= 18'(step_1[18] ? -step_1 : step_1);
    behind_3 <= !away_2 && close[2] && magnitude_2 > occlusion;
    before_3 <= away_2 && close[2] && magnitude_2 > occlusion;
    fiftyfold_3 <= {1'b0, magnitude_2, 5'd0} + {2'b0, magnitude_2, 4'd0} + {5'd0, magnitude_2, 1'b0};
  end

  // What was seen at earlier pushes; [1] at the one before.
  logic [BEFORE:1] was_behind, was_parallel;
  logic [BEFORE+AFTER:1] was_before;
  logic steep;
  wire behind = behind_3 && counting[3];
  wire parallel = steep && fiftyfold_3 > 24'(previous_3) && counting[3];

  always_ff @(posedge clk) begin
    masked <= behind || was_behind != '0 || was_parallel[BEFORE] || was_before[BEFORE+AFTER:BEFORE+1] != '0;
    if (!rst_n) begin
      was_behind   <= '0;
      was_parallel <= '0;
      was_before   <= '0;
    end else if (pushed[3]) begin
      was_behind   <= {was_behind[BEFORE-1:1], behind};
      was_parallel <= {was_parallel[BEFORE-1:1], parallel};
      was_before   <= {was_before[BEFORE+AFTER-1:1], before_3 && counting[3]};
    end
    if (pushed[3]) steep <= fiftyfold_3 > 24'(range_3);
  end
endmodule

`default_nettype wire
