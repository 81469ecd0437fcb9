"""How good causes are: faults put into plants and cars, one or two at a time, and what the gateway says of them."""
