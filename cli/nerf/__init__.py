"""`nerf`: fit radiance fields that lean on depth priors."""

from cli.program import Program

PROGRAM = Program(
    "nerf",
    "radiance fields of streets that lean on depth priors",
    {
        "fit": "train a field on a drive, with or without a prior, and score its held-out views",
        "eval": "score a run's held-out views again, or put several runs into one table",
        "report": "write one page: table, held-out views to compare by a slider, plots, videos",
        "render": "render views: the drive's own, or poses from a file",
        "video": "render a video along the drive's path",
        "view": "look at a field, live in a browser",
        "export": "write a point cloud or a mesh",
        "study": "fit a grid of priors, views, losses and fields; one table",
        "bench": "fit fields side by side: quality against time",
        "stress": "run every numerical routine of fields at the limits of its numbers",
    },
    """\
  nerf fit street/ --prior cache/ --views sparse --time 60s       -> runs/..., held-out views scored
  nerf fit street/ --views sparse                                 colours alone, to compare
  nerf fit street/ --prior cache/ --field mip360 --loss urf
  nerf eval runs/*                                                one table
  nerf report runs/* --cache cache/                               one page to open: report.html
  nerf video runs/NAME
  nerf view runs/NAME                                             live in a browser
  nerf study street/ --priors cache/* --views dense sparse --field ngp""",
)
main = PROGRAM.main
