"""The attack suite: hostile clients against a real server process, beside good clients that must not be harmed."""
