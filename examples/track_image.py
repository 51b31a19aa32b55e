"""Both hands in metres from one photograph: python examples/track_image.py PHOTO [FIELD_OF_VIEW_DEG]"""

import sys

import twohands

image = twohands.read_image(sys.argv[1])
field_of_view = float(sys.argv[2]) if len(sys.argv) > 2 else 60.0
camera = twohands.PinholeCamera.from_fov(field_of_view, width=image.shape[1], height=image.shape[0])
estimator = twohands.HandEstimator.from_preset()

pose = estimator.estimate(image, camera, hand_length_m=0.10)
for name, hand in (("left", pose.left), ("right", pose.right)):
    if hand.joints_m is None:
        print(f"{name} hand: not found")
        continue
    x, y, z = hand.joints_m[8]  # tip of the index finger; camera frame, metres
    print(f"{name} hand: {100 * hand.range_m:.1f} cm away, index fingertip at x {x:+.3f} y {y:+.3f} z {z:+.3f} m")
