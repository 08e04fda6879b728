"""How a person follows a speed and a direction, in numpy alone: for the server's engine and the evaluation."""
