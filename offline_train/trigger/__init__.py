"""Train the linear trigger: generate -> observe -> fit -> calibrate -> evaluate -> export."""
