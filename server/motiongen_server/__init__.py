"""The motiongen server: an application that streams generated motion for many characters at once."""
