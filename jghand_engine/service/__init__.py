"""The renderer as a process of its own, for Blender.

protocol   the messages on the socket; standard library only, copied into the Blender extension
commands   what each request does, with no socket in sight
requests   the queue of one client: in order, canceled by number
server     the process: handshake, token, heart-beat, replies, a clean end

This module imports nothing, so that Blender's Python can import `jghand_engine.service.protocol`.
"""
