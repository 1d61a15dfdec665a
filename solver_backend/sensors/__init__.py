"""Retro-reflective markers by infrared and depth sensors: devices, what each of them sees, and one cloud of it all.

The chain of the thesis (section 5.3.2) and of its paper (appendix K), as parts that know as little of one another as
they can: ``devices`` give frames, ``acquisition`` makes sightings with covariances of a frame, ``fusion`` makes one
cloud of the sightings of all sensors, ``streaming`` does the same while it happens.
"""
