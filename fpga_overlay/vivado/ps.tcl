# The processing system. On the board its memory and pins are set up by the image that boots it, not by an overlay; PYNQ
# takes from the .hwh the clock of the logic and the widths of the ports, and sets those. So what follows has to agree
# with the board, but does not configure it.

# Vivado's board files have the whole ZCU104 preset. Without them the memory is described by hand.
proc use_board_part {} {
    set boards [lsort -dictionary [get_board_parts -quiet {*:zcu104:part0:*}]]
    if {[llength $boards]} {
        set_property board_part [lindex $boards end] [current_project]
    } else {
        puts "splitslam: no ZCU104 board files in this Vivado; the memory is taken from ps.tcl"
    }
}

# ZCU104 (UG1267): 2 GB on the processing system, four DDR4 devices of 256M x 16 (MT40A256M16GE-083E), run at 2133 MT/s.
proc zcu104_memory {} {
    return {
        CONFIG.PSU__DDRC__MEMORY_TYPE {DDR 4}
        CONFIG.PSU__DDRC__COMPONENTS {Components}
        CONFIG.PSU__DDRC__BUS_WIDTH {64 Bit}
        CONFIG.PSU__DDRC__DRAM_WIDTH {16 Bits}
        CONFIG.PSU__DDRC__DEVICE_CAPACITY {4096 MBits}
        CONFIG.PSU__DDRC__ROW_ADDR_COUNT {15}
        CONFIG.PSU__DDRC__BG_ADDR_COUNT {1}
        CONFIG.PSU__DDRC__SPEED_BIN {DDR4_2133P}
        CONFIG.PSU__DDRC__CL {15}
        CONFIG.PSU__DDRC__CWL {14}
        CONFIG.PSU__DDRC__T_RCD {15}
        CONFIG.PSU__DDRC__T_RP {15}
        CONFIG.PSU__DDRC__T_RC {47.06}
        CONFIG.PSU__DDRC__T_RAS_MIN {33}
        CONFIG.PSU__DDRC__T_FAW {30.0}
        CONFIG.PSU__CRF_APB__DDR_CTRL__FREQMHZ {1067}
    }
}

# M_AXI_GP0 is M_AXI_HPM0_FPD; S_AXI_GP2 and S_AXI_GP3 are S_AXI_HP0_FPD and S_AXI_HP1_FPD.
proc overlay_ports {clock_mhz} {
    return [list \
        CONFIG.PSU__USE__M_AXI_GP0 1 \
        CONFIG.PSU__USE__M_AXI_GP1 0 \
        CONFIG.PSU__USE__M_AXI_GP2 0 \
        CONFIG.PSU__MAXIGP0__DATA_WIDTH 32 \
        CONFIG.PSU__USE__S_AXI_GP2 1 \
        CONFIG.PSU__USE__S_AXI_GP3 1 \
        CONFIG.PSU__SAXIGP2__DATA_WIDTH 128 \
        CONFIG.PSU__SAXIGP3__DATA_WIDTH 128 \
        CONFIG.PSU__USE__IRQ0 1 \
        CONFIG.PSU__USE__FABRIC__RST 1 \
        CONFIG.PSU__FPGA_PL0_ENABLE 1 \
        CONFIG.PSU__CRL_APB__PL0_REF_CTRL__FREQMHZ $clock_mhz]
}

proc make_processing_system {clock_mhz} {
    # 3.4 in 2022.1, later versions later: the newest of the catalogue. What is set here has the same names in all.
    set ps [create_bd_cell -type ip -vlnv [newest_ip zynq_ultra_ps_e] zynq_ultra_ps_e_0]
    if {[get_property board_part [current_project]] ne ""} {
        apply_bd_automation -rule xilinx.com:bd_rule:zynq_ultra_ps_e -config {apply_board_preset 1} $ps
    } elseif {[catch {set_property -dict [zcu104_memory] $ps} message]} {
        error "this Vivado refuses the memory in ps.tcl: install its ZCU104 board files. It says: $message"
    }
    set_property -dict [overlay_ports $clock_mhz] $ps
    return $ps
}
