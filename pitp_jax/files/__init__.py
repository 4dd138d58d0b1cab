"""What is read and written: containers, recordings, model files, exports, MuJoCo files."""
