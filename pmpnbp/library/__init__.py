"""What `import pmpnbp` offers: estimates, sessions and recordings in Python, without a server."""
