"""Commands of `startracker`: they parse, call, print. Heavy imports wait until one needs them."""
