"""Ways to a board: serial ports and everything pyserial can open by URL, and I2C."""
