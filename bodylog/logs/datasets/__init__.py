"""Datasets as logs: LeRobot folders, HDF5 episodes, folders of tables, images and videos.

Each reader gives an `EpisodeLog`, which fulfils protocol.Log. pyarrow, h5py and av are imported when they are needed.
"""
