"""For operators: health and metrics over HTTP, traces, logs, memory."""
