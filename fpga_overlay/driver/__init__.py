"""The PYNQ driver of the cores: what the edge agent's deskew back ends `fpga` and `cosim` call."""

from fpga_overlay.driver.accelerator import Accelerator
from fpga_overlay.driver.answer import AcceleratedImage
from fpga_overlay.driver.errors import AcceleratorError

__all__ = ["AcceleratedImage", "Accelerator", "AcceleratorError"]
