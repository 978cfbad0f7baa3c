"""`python -m cli.nerf fit ...`, as torchrun starts it: torchrun --nproc-per-node 2 -m cli.nerf -- fit ..."""

from cli.nerf import main

if __name__ == "__main__":
    main()
