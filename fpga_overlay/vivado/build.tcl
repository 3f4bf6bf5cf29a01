# Builds the overlay for the ZCU104 without a project: block design, synthesis, placement, routing, checks, outputs.
#
#   vivado -mode batch -source build.tcl -tclargs -rings 128 -columns 2048 -clock_mhz 100 -jobs 2 -out DIR
#
# Leaves splitslam.bit, splitslam.hwh and reports in DIR, everything else in DIR/work. A build that misses timing
# leaves its reports, no bitstream, and exit code 1. Never run on a board; see ../README.md.

set here [file dirname [file normalize [info script]]]
foreach part {options checks ps block_design} {
    source [file join $here $part.tcl]
}

proc read_sources {rtl} {
    read_verilog -sv [lsort [glob -directory $rtl *.sv]]
    read_verilog [lsort [glob -directory $rtl *.v]]
    # Module references need the hierarchy to be known, which a session without a project does not work out by itself.
    set_property source_mgmt_mode All [current_project]
    update_compile_order -fileset sources_1
}

# The block design is synthesised with the rest in one go: no out-of-context runs, no cache that could be stale.
proc generate_top {} {
    set design [get_files splitslam.bd]
    set_property synth_checkpoint_mode None $design
    generate_target all $design
    make_wrapper -files $design -top
    read_verilog [find_file [pwd] splitslam_wrapper.v]
}

proc implement {part} {
    synth_design -top splitslam_wrapper -part $part
    opt_design
    place_design
    phys_opt_design
    route_design
    write_checkpoint -force routed.dcp
}

proc write_reports {out} {
    report_utilization -file [file join $out utilization.rpt]
    report_utilization -hierarchical -file [file join $out utilization_hierarchical.rpt]
    report_timing_summary -max_paths 10 -file [file join $out timing.rpt]
    report_power -file [file join $out power.rpt]
    report_drc -file [file join $out drc.rpt]
    report_methodology -file [file join $out methodology.rpt]
}

proc build {arguments here} {
    check_version [version -short]
    array set option [parse_options $arguments]
    set out [file normalize $option(out)]
    set rtl [file normalize [file join $here .. rtl]]
    # Nothing of an earlier build may be taken for this one's.
    file mkdir $out
    file delete -force [file join $out work] {*}[glob -nocomplain -directory $out *.bit *.hwh *.rpt]
    file mkdir [file join $out work]
    cd [file join $out work]

    set_param general.maxThreads $option(jobs)
    create_project -in_memory -part $option(part) splitslam
    use_board_part
    read_sources $rtl
    make_block_design $option(rings) $option(columns) $option(clock_mhz)
    generate_top
    read_xdc [file join $here splitslam.xdc]
    implement $option(part)
    write_reports $out
    check_timing_met [report_timing_summary -return_string]
    write_bitstream -force [file join $out splitslam.bit]
    file copy -force [find_file [pwd] splitslam.hwh] [file join $out splitslam.hwh]
    check_outputs $out {splitslam.bit splitslam.hwh utilization.rpt timing.rpt power.rpt}
    puts "splitslam: [file join $out splitslam.bit]"
}

if {[catch {build $argv $here} message]} {
    puts stderr "splitslam: $message"
    exit 1
}
exit 0
