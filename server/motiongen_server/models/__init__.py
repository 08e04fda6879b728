"""The models of a server: creates, holds and releases their engines."""
