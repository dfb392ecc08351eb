"""How bytes move between peers. Knows no maps: a payload is bytes, a peer is a name."""
