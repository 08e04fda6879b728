"""Streams: what is read from a client, whose session it is for, and what is written to the client."""
