"""What the keys and the names of lens models in camera files mean, by whomever they are written.

All are compared by their letters and digits in small letters.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

COEFFICIENTS: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FIELD_OF_KEY: Final[Mapping[str, str]] = {
    alias: name
    for name, aliases in {
        "fx": "fx flx focallengthx focalx",
        "fy": "fy fly focallengthy focaly",
        "focal": "f focal focallength",
        "cx": "cx",
        "cy": "cy",
        "cx_opencv": "ppx",
        "cy_opencv": "ppy",
        "width": "width w imagewidth imgwidth",
        "height": "height h imageheight imgheight",
        "size": "imagesize imgsize size resolution cameraresolution imageresolution imageshapewh",
        "matrix": "cameramatrix camera_matrix k kmatrix mtx intrinsicmatrix intrinsicsmatrix cameraintrinsics "
        "cameraintrinsic intrinsic",
        "intrinsics": "intrinsics",
        "params": "params",
        "distortion": "distortion dist d distcoeffs distcoeff distcoefs distcoef distortioncoefficients "
        "distortioncoeffs distortioncoeff distortionvector distortionparameters lensdistortion cameradistortion coeffs "
        "coefficients distorsion distorsioncoefficients",
        **{name: name for name in (*COEFFICIENTS, "s1", "s2", "s3", "s4")},
        "model": "distortionmodel cameramodel model lensmodel lenstype projection projectiontype projectionmodel "
        "cameratype type distortiontype modeltype modelname",
        "fisheye": "fisheye isfisheye fisheyemodel",
        "skew": "skew s",
        "binning": "binningx binningy",
        "roi": "roi",
    }.items()
    for alias in aliases.split()
}
"""What a key means, by its letters and digits in small letters."""
SLAM_FIELDS: Final[Mapping[str, str]] = {
    **{name: name for name in ("fx", "fy", "width", "height", *COEFFICIENTS)},
    **{name: f"{name}_opencv" for name in ("cx", "cy")},
}
"""What ORB-SLAM's keys mean, Camera.fx or Camera1.fx: it counts pixels as OpenCV does."""
CONTAINERS: Final = frozenset(
    {"intrinsics", "intrinsic", "camera", "cam", "cam0", "camera0", "cameraparameters", "cameraparams", "calibration"}
    | {"camerainfo", "cameracalibration", "imagesize", "resolution", "value0", "size", "cameraintrinsics"}
    | {"projectionparameters", *(key for key, name in FIELD_OF_KEY.items() if name == "distortion")}
)
"""Keys under which a file may hold the record, or a part of it, one level deeper."""
FROM_PIXEL_CENTRES: Final[Mapping[str, Mapping[str, str]]] = {
    "projectionparameters": {name: f"{name}_opencv" for name in ("cx", "cy")}
}
"""Of those keys, whose cx and cy count from the centre of the first pixel, as in a camera matrix (VINS-Mono)."""
NO_MATTER: Final = re.compile(
    "|".join(
        (
            "comments?|notes?|description|name|title|id|uuid|serial.*|vendor|manufacturer|make|timestamp|date|time",
            "camera|cameraname|cameraid|cameraserial.*|camname|sensorname|device.*|firmware.*|lensname",
            "calibration(?:date|time|flags|tool|method|version)?|version|fileversion|typeid|created.*|source|author",
            "flags?.*|n?frames(?:count)?|nr?of(?:frames|images)|numberof.*|num.*|fps|camerafps|camerargb|rgb",
            ".*(?:reprojection|calibration|projection|rms|mean)error.*|rms|error|reproj.*|totalavgerr|avgerr.*|std.*",
            "board.*|square.*|marker.*|pattern.*|grid.*|chessboard.*|charuco.*|aruco.*|fix.*|assume.*|calibrate.*",
            "writeextrinsic.*|writepoints.*|showundistorted|inputs?(?:delay|path)?|images?(?:points|names|path)",
            "objectpoints|imagenames|filenames?|file|path|aspectratio|extrinsics?.*|perview.*|rvecs?|tvecs?|t|pose.*",
            "rotation.*|translation.*|rectification.*|r|p|q|projectionmatrix|header|frameid|seq|stamp|opencv.*",
            "t(?:cam|cn|ci|ic|bs|b).*|rostopic|timeshift.*|camoverlaps|bf|camerabf|thdepth.*|depthmapfactor|baseline",
            "(?:orbextractor|viewer|system|stereo|imu|rgbd|loopclosing|tracking)[a-z].*|aabbscale|appliedtransform",
            "appliedscale|plyfilepath|orientationoverride|cameraanglex|cameraangley|xfov|yfov|hfov|vfov|fov",
            "transform.*|stride|format|sensortype|ratehz",
        )
    )
)
"""Keys, as in `FIELD_OF_KEY`, that say nothing about how a ray meets the picture, or say it again."""
LENS_IN_WORDS: Final = re.compile(
    "description|comments?|notes?|title|(?:camera|cam|lens|sensor|device)?name|camera|(?:camera)?id|sensortype|device|"
    "flags?.*|calibration(?:flags|method|tool)"
)
"""Keys of `NO_MATTER` whose words may say by the way what the lens is."""
OTHER_LENSES: Final = re.compile("fisheye|equidistant|equisolid|kannala|omnidirectional|catadioptric")
"""Words for lenses that are no pinhole, by their letters alone."""
NO_FISHEYE: Final = frozenset({"", "0", "no", "n", "none", "off", "false"})
"""What a key that asks for a fisheye says where there is none."""
PINHOLE: Final = frozenset(
    {"pinhole", "perspective", "plumbbob", "radtan", "radialtangential", "rationalpolynomial", "opencv", "fullopencv"}
    | {"simplepinhole", "simpleradial", "radial", "brownconrady", "brown", "none", "nodistortion", "undistorted"}
    | {"rectified", "standard", "pinholeradtan", "pinholecamera", "distortionnone", "distortionbrownconrady", "0"}
)
"""Names of lens models, written like the keys, that OpenCV's pinhole camera covers."""
FOCAL_ONLY_WHEN_STRAIGHT: Final = frozenset(
    {"modifiedbrownconrady", "inversebrownconrady", "distortioninversebrownconrady", "distortionmodifiedbrownconrady"}
)
"""RealSense's models that differ from OpenCV's in the coefficients alone: read where those are all 0."""
