"""`pmpnbp calibrate`: is the belief honest for an object, a camera and a region?"""
