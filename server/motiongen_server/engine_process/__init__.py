"""Engine processes, and the gateway's communication with them."""
