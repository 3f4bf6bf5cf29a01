# The block design `splitslam`: one clock, one AXI DMA, the cores between its two streams.
#
#   DDR -> HP0 -> read_path -> axi_dma_0 MM2S -> splitslam_0 -> axi_dma_0 S2MM -> write_path -> HP1 -> DDR
#   HPM0 -> control -> axi_dma_0, axi_intc_0;  mm2s_introut, s2mm_introut -> axi_intc_0 -> pl_ps_irq0

proc newest_ip {name} {
    set found [lsort -dictionary [get_ipdefs -quiet -filter "VLNV =~ xilinx.com:ip:$name:*"]]
    if {![llength $found]} {
        error "this Vivado's catalogue has no IP $name (is the device family Zynq UltraScale+ installed?)"
    }
    return [lindex $found end]
}

# PYNQ's driver of the DMA is bound to version 7.1, that of the interrupt controller to 4.1.
proc make_dma {} {
    set dma [create_bd_cell -type ip -vlnv xilinx.com:ip:axi_dma:7.1 axi_dma_0]
    set_property -dict [list \
        CONFIG.c_include_sg 0 \
        CONFIG.c_sg_include_stscntrl_strm 0 \
        CONFIG.c_sg_length_width 26 \
        CONFIG.c_addr_width 32 \
        CONFIG.c_include_mm2s 1 \
        CONFIG.c_m_axi_mm2s_data_width 128 \
        CONFIG.c_m_axis_mm2s_tdata_width 128 \
        CONFIG.c_include_mm2s_dre 0 \
        CONFIG.c_mm2s_burst_size 16 \
        CONFIG.c_include_s2mm 1 \
        CONFIG.c_m_axi_s2mm_data_width 128 \
        CONFIG.c_include_s2mm_dre 0 \
        CONFIG.c_s2mm_burst_size 16] $dma
}

proc make_smartconnect {name masters} {
    set cell [create_bd_cell -type ip -vlnv xilinx.com:ip:smartconnect:1.0 $name]
    set_property -dict [list CONFIG.NUM_SI 1 CONFIG.NUM_MI $masters CONFIG.NUM_CLKS 1] $cell
}

proc connect_interfaces {pairs} {
    foreach {from to} $pairs {
        connect_bd_intf_net [get_bd_intf_pins $from] [get_bd_intf_pins $to]
    }
}

proc connect_pin {driver loads} {
    foreach load $loads {
        connect_bd_net [get_bd_pins $driver] [get_bd_pins $load]
    }
}

# PYNQ awaits interrupts through an AXI interrupt controller, and finds its inputs through an xlconcat or directly. A
# Vivado that has only the inline concatenation gets the receiving side's interrupt alone, which is the one waited for.
proc make_interrupts {} {
    set intc [create_bd_cell -type ip -vlnv xilinx.com:ip:axi_intc:4.1 axi_intc_0]
    set_property CONFIG.C_IRQ_CONNECTION 1 $intc
    if {[llength [get_ipdefs -quiet -filter {VLNV =~ xilinx.com:ip:xlconcat:*}]]} {
        set concat [create_bd_cell -type ip -vlnv [newest_ip xlconcat] interrupts]
        set_property CONFIG.NUM_PORTS 2 $concat
        connect_pin axi_dma_0/mm2s_introut interrupts/In0
        connect_pin axi_dma_0/s2mm_introut interrupts/In1
        connect_pin interrupts/dout axi_intc_0/intr
    } else {
        connect_pin axi_dma_0/s2mm_introut axi_intc_0/intr
    }
    connect_pin axi_intc_0/irq zynq_ultra_ps_e_0/pl_ps_irq0
}

proc connect_clock_and_reset {} {
    create_bd_cell -type ip -vlnv xilinx.com:ip:proc_sys_reset:5.0 reset_0
    connect_pin zynq_ultra_ps_e_0/pl_clk0 {
        zynq_ultra_ps_e_0/maxihpm0_fpd_aclk zynq_ultra_ps_e_0/saxihp0_fpd_aclk zynq_ultra_ps_e_0/saxihp1_fpd_aclk
        reset_0/slowest_sync_clk control/aclk read_path/aclk write_path/aclk
        axi_dma_0/s_axi_lite_aclk axi_dma_0/m_axi_mm2s_aclk axi_dma_0/m_axi_s2mm_aclk
        axi_intc_0/s_axi_aclk splitslam_0/aclk
    }
    connect_pin zynq_ultra_ps_e_0/pl_resetn0 reset_0/ext_reset_in
    connect_pin reset_0/interconnect_aresetn {control/aresetn read_path/aresetn write_path/aresetn}
    connect_pin reset_0/peripheral_aresetn {axi_dma_0/axi_resetn axi_intc_0/s_axi_aresetn}
    # The DMA's reset, and its soft reset after a time-out: without it the cores would wait for the rest of a cut packet.
    connect_pin axi_dma_0/mm2s_prmry_reset_out_n splitslam_0/aresetn
}

proc assign {space segment offset range} {
    assign_bd_address -offset $offset -range $range \
        -target_address_space [get_bd_addr_spaces $space] [get_bd_addr_segs $segment] -force
}

# The DMA sees the 2 GB of DDR and nothing else of the processing system.
proc assign_addresses {} {
    assign zynq_ultra_ps_e_0/Data axi_dma_0/S_AXI_LITE/Reg 0xA0000000 64K
    assign zynq_ultra_ps_e_0/Data axi_intc_0/S_AXI/Reg 0xA0010000 64K
    foreach {space port name} {Data_MM2S SAXIGP2 HP0 Data_S2MM SAXIGP3 HP1} {
        assign axi_dma_0/$space zynq_ultra_ps_e_0/$port/${name}_DDR_LOW 0x00000000 2G
        foreach segment [get_bd_addr_segs -quiet zynq_ultra_ps_e_0/$port/*] {
            if {![string match *_DDR_LOW $segment]} {
                exclude_bd_addr_seg -quiet -target_address_space [get_bd_addr_spaces axi_dma_0/$space] $segment
            }
        }
    }
}

proc make_block_design {rings columns clock_mhz} {
    create_bd_design splitslam
    make_processing_system $clock_mhz
    make_dma
    make_smartconnect read_path 1
    make_smartconnect write_path 1
    make_smartconnect control 2
    set cores [create_bd_cell -type module -reference splitslam_axis splitslam_0]
    set_property -dict [list CONFIG.RINGS $rings CONFIG.COLUMNS $columns] $cores
    make_interrupts
    connect_interfaces {
        axi_dma_0/M_AXI_MM2S read_path/S00_AXI
        read_path/M00_AXI zynq_ultra_ps_e_0/S_AXI_HP0_FPD
        axi_dma_0/M_AXIS_MM2S splitslam_0/s_axis
        splitslam_0/m_axis axi_dma_0/S_AXIS_S2MM
        axi_dma_0/M_AXI_S2MM write_path/S00_AXI
        write_path/M00_AXI zynq_ultra_ps_e_0/S_AXI_HP1_FPD
        zynq_ultra_ps_e_0/M_AXI_HPM0_FPD control/S00_AXI
        control/M00_AXI axi_dma_0/S_AXI_LITE
        control/M01_AXI axi_intc_0/s_axi
    }
    connect_clock_and_reset
    assign_addresses
    validate_bd_design
    save_bd_design
}
