"""`priors`: make, judge and look at depth priors."""

from cli.program import Program

PROGRAM = Program(
    "priors",
    "depth priors for street drives",
    {
        "build": "make depth maps for a drive and cache them",
        "import": "take depth maps that another program made into the cache",
        "eval": "score cached maps against the drive's truth",
        "report": "write one page: tables, pictures to compare by a slider, plots",
        "show": "write pictures: image, depth, error and confidence side by side",
        "video": "write a video: images and depth over a drive, side by side",
        "view": "look at a drive and its priors in 3D, live in a browser",
        "export": "write a prior for nerfstudio, COLMAP, 3DGS, KITTI; as PLY; a network as ONNX",
        "list": "list what a cache holds",
        "bench": "run time against error of every method, on a drive of yours",
        "plan": "what a drive has, needs and does not need, before anything is built",
        "check": "audit a drive: calibration, joins, stereo, poses, LiDAR",
        "poses": "refine a drive's poses by what its images see",
        "train": "train the networks: render samples, train, pack weights",
        "street": "write the embedded street as a KITTI raw drive",
        "stress": "run every numerical routine at the limits of its numbers",
    },
    """\
  priors street street/ --frames 40 --size 1242x375     the embedded street: no download needed
  priors check street/                                  is the drive sound?
  priors build street/ --method stereo                  depth maps -> cache/
  priors build KITTI/2011_09_26 --drive 2011_09_26_drive_0001_sync --method lidar --lidar.sweeps 11
  priors build street/ --method completion --sky mask --clip 80
  priors eval cache/                                    one table, a row a prior
  priors report cache/                                  one page to open: report.html
  priors show cache/ --frames 5:8                       pictures
  priors view cache/                                    points in 3D, live in a browser
  priors export cache/DRIVE/stereo-KEY --to nerfstudio  images, poses, depth, and the ns-train line""",
)
main = PROGRAM.main
