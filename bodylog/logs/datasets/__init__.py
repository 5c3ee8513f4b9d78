"""Datasets as logs: LeRobot folders, HDF5 episodes, folders of tables, images and videos.

Each reader returns an `EpisodeLog`, a protocol.Log. pyarrow, h5py and av are imported on first use.
"""
