"""Whether a kernel has become slower, asked without a clock's milliseconds: as a ratio to kernels that never change."""
