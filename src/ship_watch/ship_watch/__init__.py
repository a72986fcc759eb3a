"""What the outputs of a suite say to who watches them: is each angle safe, which source is out and why, what happened.

The live page, the terminal view, the alerts and the report all read it, so that they never disagree. It takes decoded
messages and the times at which they came, and knows no ROS, no clock and no file but the ship's limits.
"""
