"""What peers agree on: messages, replicas, their sum.

No I/O, no clock, no threads, no randomness but a given seed: time is an argument, messages are bytes in and bytes out.
So a whole swarm runs in one process under a fake clock, with the very code that ships.
"""
