"""The engine: pure policy over plain data, one loop on its own thread. Imports numpy and the standard library only."""
