"""What `pmpnbp.Client` offers: estimates, sessions and recordings of a server elsewhere, over REST."""
