#!/usr/bin/env python3
"""The wire contract in lines, one for each thing a client may rely on; proto/v1.contract holds those that may not go unsaid.

    contract.py PROTO_FOLDER                    says what of the recorded contract is gone (exit code 1), and what is new
    contract.py PROTO_FOLDER --write            records what there is now; refuses while something of it is gone
    contract.py PROTO_FOLDER --write --break    also when something is gone

A line says a field's number, name, type and presence, the name of a method or of an enum value. New lines may come.
"""
import argparse
import glob
import os
import subprocess
import sys
import tempfile

from google.protobuf import descriptor_pb2

RECORDED = "v1.contract"
HEADER = "# The wire contract: tests/proto/contract.py. Removed or changed lines break clients.\n"
LABELS = {1: "", 2: "required ", 3: "repeated "}


def type_of(field):
    if field.type_name:
        return field.type_name.lstrip(".")
    return descriptor_pb2.FieldDescriptorProto.Type.Name(field.type)[len("TYPE_"):].lower()


def lines_of_enum(enum, scope):
    name = "%s.%s" % (scope, enum.name)
    return ["enum %s" % name] + ["value %s %s = %d" % (name, v.name, v.number) for v in enum.value]


def lines_of_message(message, scope):
    name = "%s.%s" % (scope, message.name)
    out = ["message %s" % name]
    for field in message.field:
        presence = LABELS[field.label]
        if field.proto3_optional:
            presence = "optional "
        elif field.HasField("oneof_index"):
            presence = "oneof %s " % message.oneof_decl[field.oneof_index].name
        out.append("field %s %s%s %s = %d" % (name, presence, type_of(field), field.name, field.number))
    for enum in message.enum_type:
        out += lines_of_enum(enum, name)
    for nested in message.nested_type:
        out += lines_of_message(nested, name)
    return out


def lines_of_service(service, scope):
    name = "%s.%s" % (scope, service.name)
    out = ["service %s" % name]
    for method in service.method:
        arrow = lambda streams, kind: ("stream " if streams else "") + kind.lstrip(".")
        out.append("rpc %s.%s (%s) returns (%s)" % (name, method.name, arrow(method.client_streaming, method.input_type),
                                                    arrow(method.server_streaming, method.output_type)))
    return out


def contract(folder, protoc="protoc"):
    """Lines of every .proto file of horopter.v1 in the folder, sorted. Raises CalledProcessError when they do not compile."""
    protos = sorted(glob.glob(os.path.join(folder, "horopter", "v1", "*.proto")))
    with tempfile.TemporaryDirectory() as scratch:
        path = os.path.join(scratch, "set")
        subprocess.run([protoc, "-I", folder, "--descriptor_set_out", path, *protos], check=True)
        with open(path, "rb") as file:
            files = descriptor_pb2.FileDescriptorSet.FromString(file.read())
    out = []
    for file in files.file:
        for message in file.message_type:
            out += lines_of_message(message, file.package)
        for enum in file.enum_type:
            out += lines_of_enum(enum, file.package)
        for service in file.service:
            out += lines_of_service(service, file.package)
    return sorted(out)


def recorded(folder):
    with open(os.path.join(folder, RECORDED), encoding="utf-8") as file:
        return [line.rstrip("\n") for line in file if not line.startswith("#")]


def gone_and_new(kept, now):
    """Lines that must be there and are not, and lines that are not recorded yet."""
    return sorted(set(kept) - set(now)), sorted(set(now) - set(kept))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--break", dest="breaks", action="store_true")
    parser.add_argument("--protoc", default="protoc")
    arguments = parser.parse_args()
    now = contract(arguments.folder, arguments.protoc)
    path = os.path.join(arguments.folder, RECORDED)
    gone, new = gone_and_new(recorded(arguments.folder) if os.path.exists(path) else [], now)
    for line in gone:
        print("gone: %s" % line)
    for line in new:
        print("new: %s" % line)
    if gone and not arguments.breaks:
        return 1
    if arguments.write:
        with open(path, "w", encoding="utf-8") as file:
            file.write(HEADER + "\n".join(now) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
