"""Sensors without ROS: their packets from the network and serial devices, as a Source.

    port (UDP, serial, TCP) -> feed (packets -> readings on the sensor's clock) -> run's time -> events

opening.py puts it together, source.py runs it, clock.py says what time it is.
"""
