"""When images were taken: camera delays by regression
or under the body's own process, and their correction.
"""
