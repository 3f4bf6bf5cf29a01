# What makes a build fail: a Vivado that is too old, timing that is not met or not known, outputs that are not there.

proc check_version {version} {
    if {![regexp {^\d+\.\d+} $version release]} {
        error "cannot read Vivado's version from '$version'"
    }
    if {[package vcompare $release 2022.1] < 0} {
        error "Vivado $version is too old: 2022.1 to 2025.2 are supported"
    }
    if {[package vcompare $release 2025.2] > 0} {
        puts "splitslam: Vivado $version is newer than 2025.2, the last one this script was written for"
    }
}

# The slacks of report_timing_summary: setup, hold and pulse width, worst first; each 0 or more, over some endpoints.
# Run properties do not exist without a project, and no path object holds a pulse width: so the summary is read.
proc check_timing_met {summary} {
    set lines [split $summary \n]
    set header [lsearch -regexp $lines {WNS\(ns\).*WHS\(ns\).*WPWS\(ns\)}]
    set values [regexp -all -inline {\S+} [lindex $lines [expr {$header + 2}]]]
    if {$header < 0 || [llength $values] != 12} {
        error "no design timing summary in the report"
    }
    set missed {}
    foreach {kind first} {setup 0 hold 4 pulse-width 8} {
        lassign [lrange $values $first [expr {$first + 3}]] slack total failing endpoints
        if {![string is double -strict $slack] || ![string is integer -strict $endpoints] || $endpoints == 0} {
            error "no $kind slack: no endpoint is timed"
        }
        puts "splitslam: worst $kind slack $slack ns over $endpoints endpoints"
        if {$slack < 0 || $failing > 0} {
            lappend missed "$kind slack $slack ns, $failing endpoints fail"
        }
    }
    if {[llength $missed]} {
        error "timing is not met: [join $missed {; }]"
    }
    foreach gap {no_clock unconstrained_internal_endpoints} {
        if {[regexp "checking $gap \\((\\d+)\\)" $summary all count] && $count > 0} {
            error "timing is not known: $gap $count"
        }
    }
}

proc check_outputs {folder names} {
    foreach name $names {
        set path [file join $folder $name]
        if {![file isfile $path] || [file size $path] == 0} {
            error "the build left no $path"
        }
    }
}

# Where Vivado puts generated files depends on its version (.srcs, .gen or beside the design): looked for by name.
proc find_file {folder name} {
    set pending [list $folder]
    while {[llength $pending]} {
        set pending [lassign $pending here]
        if {[file isfile [file join $here $name]]} {
            return [file join $here $name]
        }
        lappend pending {*}[lsort [glob -nocomplain -directory $here -types d *]]
        foreach hidden [lsort [glob -nocomplain -directory $here -types {d hidden} .*]] {
            if {[file tail $hidden] ni {. ..}} {
                lappend pending $hidden
            }
        }
    }
    error "Vivado generated no $name below $folder"
}
