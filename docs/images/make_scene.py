#!/usr/bin/python3
"""Makes scene.jpg, the picture of the README: a scene's images, and the server's drawing over one of them.

    make_scene.py SERVER DATASET/SPLIT/SCENE OUT.jpg [--image N] [--part X Y WIDTH]     with PYTHONPATH=build/release/client/python

Needs a server with the data set's parts enrolled, Debian's python3-opencv and python3-grpcio.
"""
import argparse
import os

import cv2
import numpy as np
from horopter import Client


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("server")
    parser.add_argument("scene")
    parser.add_argument("out")
    parser.add_argument("--image", type=int, default=0, help="the one that is shown with the answer, from 0")
    parser.add_argument("--part", type=int, nargs=3, metavar=("X", "Y", "WIDTH"), help="of that image, 4:3, enlarged (default: all of it)")
    arguments = parser.parse_args()
    folder = os.path.join(arguments.scene, "rgb")
    paths = [os.path.join(folder, name) for name in sorted(os.listdir(folder))][:4]
    with Client(arguments.server) as client:
        scene = client.recognize(paths, overlay="png")
    for part in scene.objects:
        print(part.object_id, round(part.score, 3), [g.name for g in part.grasps])
    images = [cv2.imread(p) for p in paths]
    small = [cv2.resize(i, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for i in images]
    grid = np.vstack([np.hstack(small[:2]), np.hstack(small[2:4])])
    answer = cv2.imdecode(np.frombuffer(scene.overlays[arguments.image], np.uint8), cv2.IMREAD_COLOR)
    if arguments.part:
        x, y, width = arguments.part
        answer = cv2.resize(answer[y:y + 3 * width // 4, x:x + width], (640, 480), interpolation=cv2.INTER_CUBIC)
    gap = np.full((480, 12, 3), 255, np.uint8)
    cv2.imwrite(arguments.out, np.hstack([grid, gap, answer]), [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main()
