#!/usr/bin/env python3
"""From a CAD file to a drawn answer, with TLS and a token: no other program is needed.

    first_part.py CAD_FILE IMAGE... [--server HOST:PORT] [--tls-ca ca.pem] [--token-file admin.token] [--unit mm] [--out answer]

Enrols the part (the server reads the file; the token's role is admin), recognises it in the images of one scene and writes what the
server has drawn on them: answer-0.png, answer-1.png, ... The options default to the environment that the program horopter reads, too:
HOROPTER_SERVER, HOROPTER_TLS_CA, HOROPTER_TOKEN_FILE.
"""
import argparse
import os
import re
import sys

from horopter import AlreadyExists, Client, HoropterError, Security


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cad")
    parser.add_argument("images", nargs="+")
    parser.add_argument("--server")
    parser.add_argument("--tls-ca")
    parser.add_argument("--token-file")
    parser.add_argument("--unit", help="of a file that names none (STL, PLY, OBJ)")
    parser.add_argument("--out", default="answer")
    arguments = parser.parse_args()
    security = None  # from the environment
    if arguments.tls_ca or arguments.token_file:
        security = Security(ca_file=arguments.tls_ca, token_file=arguments.token_file)
    part = re.sub("[^a-z0-9_-]", "-", os.path.basename(arguments.cad).split(".")[0].lower())[:63]
    with Client(arguments.server, security=security) as client:
        try:
            made = client.import_object(part, arguments.cad, unit=arguments.unit)
            print("%s: %.1f mm, %d edges" % (part, 1e3 * made.object.diameter_m, made.object.edge_count))
            for warning in made.warnings:
                print("  " + warning)
        except AlreadyExists:
            print("%s is enrolled already" % part)
        scene = client.recognize(arguments.images, candidates=[part], overlay="png")
    print(scene.outcome, "; ".join(r.detail for r in scene.reasons))
    for found in scene.objects:
        x, y, z = 1e3 * found.scene_from_object[:3, 3]
        print("%s %.2f at %.1f %.1f %.1f mm, %d grasps" % (found.object_id, found.score, x, y, z, len(found.grasps)))
    for k, picture in enumerate(scene.overlays):
        name = "%s-%d.png" % (arguments.out, k)
        with open(name, "wb") as out:
            out.write(picture)
        print(name)
    return 0 if scene.objects else 4


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (HoropterError, OSError, ValueError) as error:
        sys.exit("first_part.py: %s" % error)
