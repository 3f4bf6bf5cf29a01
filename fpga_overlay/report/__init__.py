"""What the overlay costs and how exact it is, measured afresh: `make fpga-report`."""
