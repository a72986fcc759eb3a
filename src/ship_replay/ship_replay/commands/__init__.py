"""What people type: arguments in, lines and exit codes out.

The room imports all other rooms but ``trials/``.
"""
