"""Everything with a port or a screen: the command line now, the server later."""
