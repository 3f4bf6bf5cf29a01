# Stands in for Vivado in the tests: every command that build.tcl may use, with the options that UG835 gives it, writes
# down how it was called. Anything else is an error, as in Vivado. What it cannot do is tell what Vivado would make of it.
#
# From the environment: STUB_ARGV, STUB_LOG, STUB_VERSION, STUB_SUMMARY (what report_timing_summary says), STUB_BOARDS,
# STUB_WITHOUT (an IP that the catalogue lacks), STUB_REFUSES (a property that an IP lacks), STUB_FAILS (a command that
# fails), STUB_LOSES (an output that is not written).

set log [open $env(STUB_LOG) w]

# Defines a command. options: {-name 0|1 ...}, the number of values that follow; the body sees `option` and `rest`.
proc vivado {name options {body {}}} {
    proc $name {args} [string map [list @name $name @options $options @body $body] {
        global env log
        puts $log [list @name {*}$args]
        flush $log
        if {[info exists env(STUB_FAILS)] && $env(STUB_FAILS) eq "@name"} {
            error "@name failed"
        }
        set known {@options}
        set option {}
        set rest {}
        while {[llength $args]} {
            set args [lassign $args word]
            if {![regexp {^-[a-z]} $word]} {
                lappend rest $word
            } elseif {![dict exists $known $word]} {
                error "@name has no option $word"
            } elseif {[dict get $known $word]} {
                set args [lassign $args value]
                dict set option $word $value
            } else {
                dict set option $word 1
            }
        }
        @body
    }]
}

proc write_file {path {text stub}} {
    global env
    if {[info exists env(STUB_LOSES)] && $env(STUB_LOSES) eq [file tail $path]} {
        return
    }
    file mkdir [file dirname $path]
    set channel [open $path w]
    puts $channel $text
    close $channel
}

proc write_report {option} {
    if {[dict exists $option -file]} {
        write_file [dict get $option -file]
    }
}

# Pins and segments are only those of cells that exist.
set cells {}
proc of_cells {names} {
    foreach name $names {
        if {[lindex [split $name /] 0] ni $::cells} {
            error "no cell has $name"
        }
    }
    return $names
}

# Session and sources
vivado version {-short 0} { return $env(STUB_VERSION) }
vivado set_param {}
vivado create_project {-in_memory 0 -part 1 -force 0}
vivado current_project {} { return project }
vivado current_design {} { return design }
vivado set_property {-dict 1} {
    if {[info exists env(STUB_REFUSES)] && [dict exists $option -dict] && [dict exists [dict get $option -dict] $env(STUB_REFUSES)]} {
        error "no property $env(STUB_REFUSES)"
    }
    if {[lindex $rest 0] eq "board_part"} { set ::board [lindex $rest 1] }
}
vivado get_property {} { return $::board }
set board {}
vivado get_board_parts {-quiet 0 -latest_file_version 0} { return $env(STUB_BOARDS) }
vivado get_files {-quiet 0 -of_objects 1 -filter 1} { return $rest }
vivado read_verilog {-sv 0 -library 1} {
    foreach path [lindex $rest 0] {
        if {![file isfile $path]} { error "no file $path" }
    }
}
vivado read_xdc {-cells 1 -mode 1} { source [lindex $rest 0] }
vivado update_compile_order {-fileset 1}

# Block design
vivado create_bd_design {-dir 1}
vivado create_bd_cell {-type 1 -vlnv 1 -reference 1} {
    lappend ::cells $rest
    return $rest
}
vivado get_ipdefs {-quiet 0 -all 0 -filter 1} {
    regexp {xilinx.com:ip:(\w+):} [dict get $option -filter] all ip
    if {$ip eq $env(STUB_WITHOUT)} { return {} }
    return [list xilinx.com:ip:$ip:3.9 xilinx.com:ip:$ip:3.10]
}
vivado apply_bd_automation {-rule 1 -config 1}
vivado get_bd_pins {-quiet 0} { return [of_cells $rest] }
vivado get_bd_intf_pins {-quiet 0} { return [of_cells $rest] }
vivado get_bd_addr_spaces {-quiet 0} { return [of_cells $rest] }
vivado get_bd_addr_segs {-quiet 0} {
    of_cells $rest
    regexp {SAXIGP(\d)/\*} $rest all port
    if {![string match {*/\*} $rest]} { return $rest }
    set hp HP[expr {$port - 2}]
    return [lmap name {DDR_LOW LPS_OCM QSPI} { string map [list * ${hp}_$name] $rest }]
}
vivado connect_bd_net {-net 1} { if {[llength $rest] != 2} { error "connect_bd_net: two pins" } }
vivado connect_bd_intf_net {-intf_net 1} { if {[llength $rest] != 2} { error "connect_bd_intf_net: two pins" } }
vivado assign_bd_address {-offset 1 -range 1 -target_address_space 1 -force 0 -with_name 1}
vivado exclude_bd_addr_seg {-quiet 0 -target_address_space 1}
vivado validate_bd_design {-force 0}
vivado save_bd_design {}
vivado generate_target {-force 0} { write_file .gen/sources_1/bd/splitslam/hw_handoff/splitslam.hwh }
vivado make_wrapper {-files 1 -top 0 -import 0} { write_file .gen/sources_1/bd/splitslam/hdl/splitslam_wrapper.v }

# Implementation, reports, outputs
vivado synth_design {-top 1 -part 1 -flatten_hierarchy 1 -directive 1}
vivado opt_design {-directive 1}
vivado place_design {-directive 1}
vivado phys_opt_design {-directive 1}
vivado route_design {-directive 1}
vivado report_utilization {-file 1 -hierarchical 0} { write_report $option }
vivado report_power {-file 1} { write_report $option }
vivado report_drc {-file 1} { write_report $option }
vivado report_methodology {-file 1} { write_report $option }
vivado report_timing_summary {-file 1 -max_paths 1 -return_string 0} {
    write_report $option
    return $env(STUB_SUMMARY)
}
vivado write_checkpoint {-force 0} { write_file [lindex $rest 0] }
vivado write_bitstream {-force 0} { write_file [lindex $rest 0] }

set argv $env(STUB_ARGV)
source [file join [file dirname [file normalize [info script]]] .. build.tcl]
