"""What is started by name: each module parses the arguments of one executable and joins the rooms for it."""
