"""What operators see: health and metrics over HTTP, logs, memory."""
