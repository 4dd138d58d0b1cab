"""The method: from recordings in memory to models, voltages and diagnoses."""
