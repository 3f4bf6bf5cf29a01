"""What the cores compute, in integers, to the bit: the one model that RTL, driver and CPU path are held to."""
