"""The figures' colours: Okabe and Ito's, which stay apart for every kind of colour vision and in grey."""

BLACK = "#000000"
GREY = "#8c8c8c"
ORANGE = "#E69F00"
GREEN = "#009E73"
BLUE = "#0072B2"
RED = "#D55E00"
SHADE = "#f2f2f2"
XYZ = {"x": RED, "y": GREEN, "z": BLUE}
