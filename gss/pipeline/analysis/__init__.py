"""What a night's attitudes say of the sensor: accuracy, rates, sensitivity, noise, and what is wrong with the data."""
