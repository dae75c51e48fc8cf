"""Many estimates: what a manifest asks for, made on as many processes and machines as there are, kept as they come."""
