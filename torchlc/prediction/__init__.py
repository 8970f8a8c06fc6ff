"""What an object will show: passes over stations, brightness with its uncertainty, glints, and areas turned to Sun,
observer or air.
"""
