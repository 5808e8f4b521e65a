"""`palpate view` and `palpate replay`: sessions in real time, recordings, and the server of the page."""
