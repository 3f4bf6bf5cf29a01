# Options of build.tcl: the defaults are the whole list, and what is not in it is refused.

proc default_options {} {
    return {
        rings 128
        columns 2048
        clock_mhz 100
        jobs 2
        part xczu7ev-ffvc1156-2-e
        out build/zcu104
    }
}

proc parse_options {arguments} {
    set options [default_options]
    if {[llength $arguments] % 2} {
        error "options come in pairs, -name value: $arguments"
    }
    foreach {name value} $arguments {
        set key [string range $name 1 end]
        if {[string index $name 0] ne "-" || ![dict exists $options $key]} {
            error "no option $name; there are: -[join [dict keys $options] { -}]"
        }
        dict set options $key $value
    }
    check_power_of_two $options rings 2 128
    check_power_of_two $options columns 4 2048
    check_range $options clock_mhz 10 300
    check_range $options jobs 1 32
    return $options
}

proc check_range {options key low high} {
    set value [dict get $options $key]
    if {![string is integer -strict $value] || $value < $low || $value > $high} {
        error "-$key $value: a whole number from $low to $high is needed"
    }
}

# Storage of the range image; a sensor may have any number up to it.
proc check_power_of_two {options key low high} {
    check_range $options $key $low $high
    set value [dict get $options $key]
    if {$value & ($value - 1)} {
        error "-$key $value: a power of two is needed"
    }
}
