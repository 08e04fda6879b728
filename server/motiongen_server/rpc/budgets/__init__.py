"""What clients may use up, alone and together: messages, calls, the event loop's time, memory. Charged before work."""
