"""Whatever arrives: every decoder and the stream's state machine fed with what nobody should send."""
