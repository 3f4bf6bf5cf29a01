# The design has no pins of its own: everything goes through the processing system. Its IP creates the one clock,
# clk_pl_0, from the frequency that ps.tcl asks for, and there is no crossing to another: so no exceptions here.
set_property BITSTREAM.GENERAL.COMPRESS TRUE [current_design]
