"""`motiongen demo`: one story and seven characters beside it on one stream, from a server of its own."""
