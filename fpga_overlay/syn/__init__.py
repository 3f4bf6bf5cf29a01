"""What the cores cost on an UltraScale+ device, by an open tool: Yosys synthesis, not placed and routed."""
