// Output FIFO of a pipeline that never stops. Who puts a beat into the pipeline promises its write (`reserve`) and may
// do so only while there is `room`; so back-pressure stops what enters and never what is under way. Who cannot tell
// what it will write promises at the write and sets ROOM lower by what may be under way.
`default_nettype none

module stream_fifo #(
    parameter int WIDTH = 129,
    parameter int DEPTH = 64,  // a power of two, above the pipeline's length for one beat a clock
    parameter int ROOM = DEPTH - 1  // promised beats below which there is room
) (
    input  wire              clk,
    input  wire              rst_n,
    output logic             room,
    input  wire              reserve,
    input  wire              write,
    input  wire  [WIDTH-1:0] write_data,
    output logic             m_valid,
    input  wire              m_ready,
    output logic [WIDTH-1:0] m_data
);
  localparam int A = $clog2(DEPTH);

  (* ram_style = "distributed" *) logic [WIDTH-1:0] memory[DEPTH];
  logic [A:0] written, taken, promised;

  wire take = written != taken && (!m_valid || m_ready);

  always_ff @(posedge clk) begin
    if (write) memory[written[A-1:0]] <= write_data;
    if (take) m_data <= memory[taken[A-1:0]];
  end

  always_ff @(posedge clk) begin
    // Looks at what was promised a clock ago: one more may have been since.
    room     <= promised < (A + 1)'(ROOM);
    promised <= promised + (A + 1)'(reserve) - (A + 1)'(take);
    written  <= written + (A + 1)'(write);
    taken    <= taken + (A + 1)'(take);
    if (take) m_valid <= 1'b1;
    else if (m_ready) m_valid <= 1'b0;

    if (!rst_n) begin
      room     <= 1'b0;
      promised <= '0;
      written  <= '0;
      taken    <= '0;
      m_valid  <= 1'b0;
    end
  end
endmodule

`default_nettype wire
