"""What a shoot brings: capture files, image names matched to cameras and lamps, previews of files for the panel.

May use core.images and core.storage.
"""
