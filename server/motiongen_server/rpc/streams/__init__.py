"""Streams: read a client's messages, pass events to its sessions, and write what is sent to the client."""
