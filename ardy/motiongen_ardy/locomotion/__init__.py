"""What a speed and a direction ask of a person, with numpy alone: for the server's engine, and the evaluation."""
