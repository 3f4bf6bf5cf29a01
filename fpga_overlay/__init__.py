"""The edge agent's programmable logic: RTL, its golden model, PYNQ driver, co-simulation and build."""
