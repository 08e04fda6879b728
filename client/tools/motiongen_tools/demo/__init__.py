"""`motiongen demo`: plays a story and seven more characters on one stream of a server that it starts."""
