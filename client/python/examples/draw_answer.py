#!/usr/bin/env python3
"""Recognises parts in images and draws them: one SVG file per image, with the parts' edges and the best grasps.

    draw_answer.py [--server HOST:PORT] [--out FOLDER] IMAGE...
"""
import argparse
import base64
import os

import numpy as np

from horopter import Client

COLORS = ("#3cdc3c", "#ff7828", "#3c3cff", "#ffd200", "#dc3cff")


def polyline(pixels, color, width=2):
    if np.isnan(pixels).any():
        return ""
    return '<polyline fill="none" stroke="%s" stroke-width="%d" points="%s"/>' % (
        color, width, " ".join("%.1f,%.1f" % tuple(p) for p in pixels))


def transformed(matrix, points):
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def gripper_lines(opening_m, finger_m=0.04):
    half = opening_m / 2
    return [np.array(line, dtype=float) for line in (
        [[-half, 0, 0], [-half, 0, -finger_m], [half, 0, -finger_m], [half, 0, 0]],
        [[0, 0, -finger_m], [0, 0, -1.5 * finger_m]])]


def cup_lines(radius_m, length_m=0.04):
    turn = np.linspace(0.0, 2.0 * np.pi, 25)
    return [np.stack([radius_m * np.cos(turn), radius_m * np.sin(turn), 0.0 * turn], axis=1),
            np.array([[0, 0, 0], [0, 0, -length_m]], dtype=float)]


def draw(image_bytes, index, scene, models):
    camera = scene.cameras[index]
    kind = "jpeg" if image_bytes[:2] == b"\xff\xd8" else "png"
    out = ['<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 %d %d"><image width="%d" height="%d" '
           'href="data:image/%s;base64,%s"/>' % (camera.width_px, camera.height_px, camera.width_px, camera.height_px, kind,
                                                 base64.b64encode(image_bytes).decode())]
    for k, part in enumerate(scene.objects):
        pose = part.images[index].camera_from_object
        if pose is None:
            continue
        color = COLORS[k % len(COLORS)]
        for edge in models[part.object_id].edges:
            out.append(polyline(camera.project(transformed(pose, edge)), color))
        if part.grasps:
            best = part.grasps[0]
            camera_from_gripper = camera.camera_from_scene @ best.scene_from_gripper
            for line in cup_lines(best.cup_radius_m) if best.cup_radius_m else gripper_lines(best.jaw_opening_m):
                out.append(polyline(camera.project(transformed(camera_from_gripper, line)), "orange", 4))
        x, y = camera.project(pose[None, :3, 3])[0]
        out.append('<text x="%.0f" y="%.0f" fill="%s" font-size="24">%s %.2f</text>' % (x, y, color, part.object_id,
                                                                                       part.score))
    return "\n".join(out) + "</svg>\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--server", default="localhost:50051")
    parser.add_argument("--out", default=".")
    parser.add_argument("images", nargs="+")
    arguments = parser.parse_args()
    with Client(arguments.server) as client:
        scene = client.recognize(arguments.images)
        print(scene.outcome, "; ".join(r.detail for r in scene.reasons))
        models = {part.object_id: client.get_object(part.object_id) for part in scene.objects}
        for i, path in enumerate(arguments.images):
            with open(path, "rb") as file:
                svg = draw(file.read(), i, scene, models)
            name = os.path.join(arguments.out, "answer-%d.svg" % i)
            with open(name, "w", encoding="utf-8") as out:
                out.write(svg)
            print(name)


if __name__ == "__main__":
    main()
