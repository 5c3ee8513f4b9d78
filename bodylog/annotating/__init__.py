"""What bodylog writes into a log, and reads back."""
