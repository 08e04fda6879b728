"""`motiongen view`: a page that shows and steers characters, and the bridge between browsers and a motiongen server."""
