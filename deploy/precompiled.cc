// Nothing: the target that this file makes holds a precompiled header.
