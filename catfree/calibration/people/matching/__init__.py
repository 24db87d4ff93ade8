"""Match people across cameras, and judge whether a camera agrees with the others."""
