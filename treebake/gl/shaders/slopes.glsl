// Slopes of a surface to a picture's right and up run from -STEEPEST to STEEPEST.
const float STEEPEST = 4.0;
